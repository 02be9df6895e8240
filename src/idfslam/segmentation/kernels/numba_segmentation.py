"""Segmentation of what moves on the CPU, compiled by Numba. The plain form of the votes is in `free_space.py`."""

import numpy as np
from numba import njit

from idfslam.segmentation.constants import COMPARABLE, CONTRAST, EVERYTHING, NEAREST_SEEN, SIGMAS, SLACK, STEP, USUAL
from idfslam.sensing.depth_noise import BEST, GROWTH, NEAREST

_compiled = njit(cache=True, nogil=True, error_model="numpy")


@_compiled
def coarsen(depth, colour, cell, step, middle, nearest, farthest, brightness, darkest, brightest) -> None:  # type: ignore[no-untyped-def]
    """Fills images (h, w) with what each cell has by itself, from every `step`-th pixel of depth (H, W) and colour (H, W, 3).

    The median, nearest and farthest reading (0, infinite and 0 without any), and the mean, least and largest brightness.
    """
    rows, columns = middle.shape
    values = np.empty(cell * cell, np.float32)
    for i in range(rows):
        for j in range(columns):
            count, total, number, least, most = 0, np.float32(0), 0, np.float32(1), np.float32(0)
            for v in range(i * cell + step // 2, min((i + 1) * cell, depth.shape[0]), step):
                for u in range(j * cell + step // 2, min((j + 1) * cell, depth.shape[1]), step):
                    light = (colour[v, u, 0] + colour[v, u, 1] + colour[v, u, 2]) * np.float32(1 / 3)
                    total, number = total + light, number + 1
                    least, most = min(least, light), max(most, light)
                    z = depth[v, u]
                    if z > 0:
                        k = count
                        while k > 0 and values[k - 1] > z:
                            values[k] = values[k - 1]
                            k -= 1
                        values[k] = z
                        count += 1
            brightness[i, j], darkest[i, j], brightest[i, j] = total / max(number, 1), least, most
            middle[i, j] = values[count // 2] if count else 0
            nearest[i, j], farthest[i, j] = values[0] if count else np.inf, values[count - 1] if count else 0


@_compiled
def _sigma(z):  # type: ignore[no-untyped-def]
    beyond = max(z - NEAREST, 0.0)
    return BEST * (1 + GROWTH * beyond * beyond)


@_compiled
def _seen_at(x, y, z, b, T, rows, columns):  # type: ignore[no-untyped-def]
    """Row and column of another view in which a point z (x, y, 1) lies, and its depth there; row -1: in none.

    b: fx, fy, cx, cy of the other view, of rows x columns cells; T: the numbers of the transform to it. There are no branches, so that
    the compiler vectorises loops over points.
    """
    r = (T[8] * x + T[9] * y + T[10]) * z + T[11]
    p = (T[0] * x + T[1] * y + T[2]) * z + T[3]
    q = (T[4] * x + T[5] * y + T[6]) * z + T[7]
    nearness = 1 / r
    u, v = p * nearness * b[0] + b[2], q * nearness * b[1] + b[3]
    inside = (z > 0) & (r > NEAREST_SEEN) & (u >= -0.5) & (v >= -0.5) & (u < columns - 0.5) & (v < rows - 0.5)
    return np.int32(v + 0.5) if inside else np.int32(-1), np.int32(u + 0.5), r


@_compiled
def _numbers(T):  # type: ignore[no-untyped-def]
    """The first three rows of T (4, 4). Unlike those of an array, a loop that fills arrays need not read them again at each step."""
    return T[0, 0], T[0, 1], T[0, 2], T[0, 3], T[1, 0], T[1, 1], T[1, 2], T[1, 3], T[2, 0], T[2, 1], T[2, 2], T[2, 3]


@_compiled
def _places(depth, a, b, T, shape):  # type: ignore[no-untyped-def]
    """The cells of the other view, counted row by row, in which the cells' points lie, (h, w), -1: none; and their depths (h, w) there.

    a: 1 / fx, 1 / fy, cx, cy of the view; b: fx, fy, cx, cy of the other one; T (4, 4) to it.
    """
    place, z_there, numbers = np.empty(depth.shape, np.int32), np.empty(depth.shape), _numbers(T)
    for i in range(depth.shape[0]):
        y = (i - a[3]) * a[1]
        for j in range(depth.shape[1]):
            row, column, r = _seen_at((j - a[2]) * a[0], y, float(depth[i, j]), b, numbers, shape[0], shape[1])
            place[i, j] = row * np.int32(shape[1]) + column if row >= 0 else np.int32(-1)
            z_there[i, j] = r
    return place, z_there


@_compiled
def vote(depth, brightness, depth_b, near, far, brightness_b, dark, bright, moving, a, b, T, gone, there, fixed) -> int:  # type: ignore[no-untyped-def]
    """`free_space.plain_vote`. a, b, T: as `_places` has them."""
    rows, columns = depth.shape
    place, z_there = _places(depth, a, b, T, depth_b.shape)
    depth_b, near, far, brightness_b = depth_b.ravel(), near.ravel(), far.ravel(), brightness_b.ravel()
    dark, bright, moving = dark.ravel(), bright.ravel(), moving.ravel()
    differences, count, own, others = np.empty((rows // STEP + 1) * (columns // STEP + 1)), 0, 0.0, 0.0
    for i in range(0, rows, STEP):
        for j in range(0, columns, STEP):
            cell, r = place[i, j], z_there[i, j]
            if cell < 0:
                continue
            at = float(depth_b[cell])
            if at > 0 and abs(r - at) < COMPARABLE:
                differences[count] = abs(r - at) / (_sigma(float(depth[i, j])) + _sigma(r))
                count, own, others = count + 1, own + brightness[i, j], others + brightness_b[cell]
    spread = max(1.0, np.median(differences[:count]) / USUAL) if count else 1.0
    gain = own / max(others, 1e-6) if count else 1.0
    known = 0
    for i in range(rows):
        for j in range(columns):
            cell, r = place[i, j], z_there[i, j]
            if cell < 0:
                continue
            margin = SLACK + SIGMAS * spread * (_sigma(float(depth[i, j])) + _sigma(r))
            nearest, at = float(near[cell]), depth_b[cell]
            if np.isfinite(nearest) and r < nearest - margin:
                gone[i, j] = True
                known += 1
                continue
            nearest = nearest if np.isfinite(nearest) else float(at)
            if at > 0 and r > nearest - margin and r < far[cell] + margin:
                known += 1
                light = float(brightness[i, j])
                there[i, j] = gain * dark[cell] - CONTRAST <= light <= gain * bright[cell] + CONTRAST
                fixed[i, j] = there[i, j] and not moving[cell]
    return known


@_compiled
def count_votes(known, gone, there, fixed, testifies, settles, through, seen, agree, stood, gone_since) -> None:  # type: ignore[no-untyped-def]
    """Adds what another view says of `known` cells to the votes (h, w); it says nothing if nearly all are gone: `free_space.votes`."""
    if gone.sum() > EVERYTHING * known:
        gone[:] = False
        return
    for i in range(gone.shape[0]):
        for j in range(gone.shape[1]):
            through[i, j] += gone[i, j]
            if testifies:
                seen[i, j] += fixed[i, j]
                agree[i, j] += there[i, j]
            if settles:
                stood[i, j] |= there[i, j]
            else:
                gone_since[i, j] |= gone[i, j]


@_compiled
def look(means, depth, near, far, camera, T, number, through, seen, free, first, last) -> None:  # type: ignore[no-untyped-def]
    """`occupancy_history.plain_look`. camera: fx, fy, cx, cy; T (4, 4) from the world to it."""
    rows, columns = depth.shape
    for i in range(len(means)):
        x, y, z = means[i]
        r = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        if r <= NEAREST_SEEN:
            continue
        u = (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / r * camera[0] + camera[2]
        v = (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / r * camera[1] + camera[3]
        if not (u >= -0.5 and v >= -0.5 and u < columns - 0.5 and v < rows - 0.5):
            continue
        row, column, margin = int(v + 0.5), int(u + 0.5), SLACK + 2 * SIGMAS * _sigma(r)
        nearest = float(near[row, column])
        if np.isfinite(nearest) and r < nearest - margin:
            through[i] += 1
            free[i] = max(free[i], number)
            continue
        nearest = nearest if np.isfinite(nearest) else float(depth[row, column])
        if depth[row, column] > 0 and r > nearest - margin and r < far[row, column] + margin:
            seen[i] += 1
            first[i], last[i] = min(first[i], number), max(last[i], number)


@_compiled
def carry(cells, ages, depth, a, b, T, near, out):  # type: ignore[no-untyped-def]
    """`carrying.plain_carry`. a, b, T: as `_places` has them."""
    numbers = _numbers(T)
    for i in range(depth.shape[0]):
        for j in range(depth.shape[1]):
            if not cells[i, j]:
                continue
            x, y = (j - a[2]) * a[0], (i - a[3]) * a[1]
            row, column, r = _seen_at(x, y, float(depth[i, j]), b, numbers, near.shape[0], near.shape[1])
            if row >= 0:
                near[row, column] = min(near[row, column], r)
                out[row, column] = min(out[row, column], ages[i, j])


@_compiled
def grow(seeds, stays, depth, friends, reach, jump, slope, out) -> None:  # type: ignore[no-untyped-def] # noqa: C901
    """`region_growing.grown`: breadth first from the seeds."""
    rows, columns = seeds.shape
    distance = np.full((rows, columns), -1, np.int32)
    queue = np.empty((rows * columns, 2), np.int32)
    head, tail = 0, 0
    for i in range(rows):
        for j in range(columns):
            if not seeds[i, j]:
                continue
            around = -1
            for v in range(max(i - 1, 0), min(i + 2, rows)):
                for u in range(max(j - 1, 0), min(j + 2, columns)):
                    around += seeds[v, u]
            if around >= friends:
                distance[i, j] = 0
                queue[tail] = i, j
                tail += 1
    while head < tail:
        i, j = queue[head]
        head += 1
        out[i, j] = True
        for k in range(4):
            v, u = i + (k == 0) - (k == 1), j + (k == 2) - (k == 3)
            if v < 0 or u < 0 or v >= rows or u >= columns or distance[v, u] >= 0:
                continue
            z = depth[v, u]
            far = 0 if seeds[v, u] else distance[i, j] + 1
            if z <= 0 or stays[v, u] or far > reach or abs(z - depth[i, j]) > jump + slope * min(z, depth[i, j]):
                continue
            distance[v, u] = far
            queue[tail] = v, u
            tail += 1


@_compiled
def continue_smoothly(out, may, inverse, span, bend, step, passes) -> None:  # type: ignore[no-untyped-def]
    """`smooth_continuation.continued`: adds to `out` cells of `may` whose inverse depth goes on from three cells of it in a row."""
    rows, columns = out.shape
    for turn in range(2 * passes):
        changed = False
        for n in range(rows * columns):
            at = n if turn % 2 == 0 else rows * columns - 1 - n
            i, j = at // columns, at % columns
            if not may[i, j] or out[i, j]:
                continue
            for k in range(4):
                di, dj = (k == 0) - (k == 1), (k == 2) - (k == 3)
                v, u = i + 2 * span * di, j + 2 * span * dj
                if v < 0 or u < 0 or v >= rows or u >= columns:
                    continue
                y, x = i + span * di, j + span * dj
                if not (out[i + di, j + dj] and out[y, x] and out[v, u]):
                    continue
                near = abs(inverse[i, j] - inverse[i + di, j + dj]) < step
                if near and abs(inverse[i, j] - 2 * inverse[y, x] + inverse[v, u]) < bend:
                    out[i, j] = changed = True
                    break
        if not changed:
            return


@_compiled
def drop_regions(out, known, kept, inverse, step, corners, least, share) -> None:  # type: ignore[no-untyped-def]
    """Sets `out` to `kept` in its connected regions that have fewer known cells than `least`, or than a share of all of theirs.

    Neighbours touch by sides, with `corners` by these too, and their inverse depths differ by less than `step`.
    """
    rows, columns = out.shape
    visited, queue = np.zeros((rows, columns), np.bool_), np.empty((rows * columns, 2), np.int32)
    for i in range(rows):
        for j in range(columns):
            if not out[i, j] or visited[i, j]:
                continue
            queue[0] = i, j
            visited[i, j] = True
            head, tail, found = 0, 1, 0
            while head < tail:
                y, x = queue[head]
                head += 1
                found += known[y, x]
                for v in range(max(y - 1, 0), min(y + 2, rows)):
                    for u in range(max(x - 1, 0), min(x + 2, columns)):
                        beside = (corners | (v == y) | (u == x)) & (abs(inverse[v, u] - inverse[y, x]) < step)
                        if beside & out[v, u] & (not visited[v, u]):
                            visited[v, u] = True
                            queue[tail] = v, u
                            tail += 1
            if found < max(least, share * tail):
                for k in range(tail):
                    y, x = queue[k]
                    out[y, x] = kept[y, x]
