"""Procedural textures, compiled with Numba: colour as a function of the position on a surface.

A material is a row of 14 numbers: pattern, scale [m], contrast, glow, three colours A, B, C (linear RGB), and the seed of its random
details (-1: every surface of every shape has its own). Every pattern is band-limited: `w` is the width [m] that a pixel covers; edges are
that wide, and finer detail fades into its mean. `u`, `v` are metres on a chart of size `su` x `sv`.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from idfslam.scenes.ray_casting import OPTIONS, compiled

Colour = tuple[float, float, float]

(
    PAINT,
    WOOD,
    PLANKS,
    TILES,
    FABRIC,
    STRIPES,
    RUG,
    BOOK,
    POSTER,
    LANDSCAPE,
    WALLPAPER,
    BRICKS,
    MARBLE,
    LEAVES,
    GLAZE,
) = range(15)


_A, _B, _C = 374761393, 668265263, 1274126177

_of_numbers = njit("float64(float64, float64, float64)", **OPTIONS)
"""Compiled once, for floats: without a signature Numba compiles a version for every mix of integers and floats among the arguments."""


@compiled
def _mixed(h: int) -> float:
    """The bits of an integer shuffled into [0, 1)."""
    h = ((h ^ (h >> 13)) & 0xFFFFFFFF) * _C
    h = ((h ^ (h >> 15)) & 0xFFFFFFFF) * _B
    return ((h ^ (h >> 16)) & 0xFFFFFF) * (1 / 16777216.0)


@_of_numbers
def random(i: float, j: float, seed: float) -> float:
    """A number in [0, 1) from a lattice point: an integer hash (Wang's mixing steps)."""
    return _mixed(int(i) * _A + int(j) * _B + int(seed) * _C)


@_of_numbers
def noise(x: float, y: float, seed: float) -> float:
    """Value noise in [0, 1] with unit lattice."""
    i, j = np.floor(x), np.floor(y)
    a, b = x - i, y - j
    a, b = a * a * (3 - 2 * a), b * b * (3 - 2 * b)
    h = int(i) * _A + int(j) * _B + int(seed) * _C
    p, q, r, s = _mixed(h), _mixed(h + _A), _mixed(h + _B), _mixed(h + _A + _B)
    low, high = p + (q - p) * a, r + (s - r) * a
    return low + (high - low) * b


@compiled
def fade(period: float, w: float) -> float:
    """The visible share of a detail with this period in a pixel of width w: 1 up to w = period / 4, 0 from w = 0.6 period."""
    return min(max((0.6 - w / period) / 0.35, 0.0), 1.0)


@compiled
def grain(u: float, v: float, period: float, seed: float, w: float) -> float:
    """Band-limited noise in [-1, 1] with this lattice [m]."""
    f = fade(2 * period, w)
    return f * (2 * noise(u / period, v / period, seed) - 1) if f > 0 else 0.0


@compiled
def edge(x: float, w: float) -> float:
    """0 for x < 0, 1 for x > 0, with a ramp as wide as the pixel between."""
    return min(max(x / w + 0.5, 0.0), 1.0)


@compiled
def band(x: float, low: float, high: float, w: float) -> float:
    """1 between low and high."""
    return edge(x - low, w) * edge(high - x, w)


@compiled
def mix(a: Colour, b: Colour, t: float) -> Colour:
    """Linear interpolation between the colours a (t = 0) and b (t = 1)."""
    return a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t


@compiled
def scaled(a: Colour, k: float) -> Colour:
    """A colour, k times as bright."""
    return a[0] * k, a[1] * k, a[2] * k


@compiled
def palette(i: float, seed: float) -> Colour:
    """A muted colour by number; its hue is a hash."""
    h, k = 6.0 * random(i, 11, seed), 0.06 + 0.5 * random(i, 12, seed) ** 1.5
    low = k * (0.2 + 0.55 * random(i, 13, seed))
    r = min(max(abs(h - 3.0) - 1.0, 0.0), 1.0)
    g = min(max(2.0 - abs(h - 2.0), 0.0), 1.0)
    b = min(max(2.0 - abs(h - 4.0), 0.0), 1.0)
    return low + (k - low) * r, low + (k - low) * g * 0.85, low + (k - low) * b * 0.8


@compiled
def wood(a: Colour, b: Colour, u: float, v: float, seed: float, contrast: float, w: float) -> Colour:
    """Grain along u: growth rings seen as wavy lines, and short dark pores."""
    warp = noise(u * 1.3, v * 6.0, seed)
    x = v * 22.0 + 5.0 * warp
    ring = x - np.floor(x)
    ring = (ring * ring * ring - 0.25) * fade(1 / 22.0, w)
    pores = (noise(u * 9.0, v * 260.0, seed + 1) - 0.5) * fade(0.008, w) + (noise(u * 4.0, v * 75.0, seed + 2) - 0.5) * fade(0.027, w)
    t = 0.45 + contrast * (0.7 * ring + 0.7 * pores + 0.9 * (noise(u * 1.1, v * 4.0, seed + 3) - 0.5))
    return mix(a, b, min(max(t, 0.0), 1.0))


@compiled
def planks(a: Colour, b: Colour, c: Colour, scale: float, u: float, v: float, seed: float, contrast: float, w: float) -> Colour:
    """Floor boards of width `scale`, eight times as long, each from another tree."""
    row = np.floor(v / scale)
    x = u / (8 * scale) + random(row, 3, seed)
    board = np.floor(x)
    dy, dx = min(v / scale - row, row + 1 - v / scale) * scale, min(x - board, board + 1 - x) * 8 * scale
    tone = 0.72 + 0.55 * random(row, board, seed + 7)
    base = scaled(wood(a, b, u, v, seed + 31 * (row % 64) + 17 * (board % 32), contrast, w), tone)
    gap = 1 - edge(min(dx, dy) - 0.002, max(w, 0.001))
    return mix(base, c, gap * 0.85 * min(1.0, 0.004 / w))


@compiled
def tiles(a: Colour, b: Colour, c: Colour, scale: float, u: float, v: float, seed: float, contrast: float, w: float) -> Colour:
    """Square tiles, the two colours in a checker, grout C."""
    i, j = np.floor(u / scale), np.floor(v / scale)
    x, y = u - i * scale, v - j * scale
    base = a if (i + j) % 2 == 0 else b
    base = mix(mix(a, b, 0.5), base, fade(2 * scale, w))
    cloud = grain(u + 3 * random(i, j, seed), v, 0.07, seed + 1, w) + 0.7 * grain(u, v, 0.02, seed + 2, w)
    base = scaled(base, 1 + contrast * (0.5 * (random(i, j, seed) - 0.5) + 0.35 * cloud))
    inside = min(min(x, scale - x), min(y, scale - y))
    return mix(c, base, edge(inside - 0.003, max(w, 0.001)) if w < scale / 3 else 0.9)


@compiled
def bricks(a: Colour, b: Colour, c: Colour, scale: float, u: float, v: float, seed: float, contrast: float, w: float) -> Colour:
    """Bricks three times as long as high (`scale`), every other course shifted by half, mortar C."""
    j = np.floor(v / scale)
    x = u / (3 * scale) + 0.5 * (j % 2)
    i = np.floor(x)
    dx, dy = min(x - i, i + 1 - x) * 3 * scale, min(v / scale - j, j + 1 - v / scale) * scale
    tone = 1 + contrast * (0.4 * grain(u, v, 0.05, seed, w) + 0.4 * grain(u, v, 0.014, seed + 1, w))
    base = scaled(mix(a, b, random(i, j, seed + 2)), tone)
    mortar = scaled(c, 1 + 0.3 * grain(u, v, 0.012, seed + 3, w))
    return mix(mortar, base, edge(min(dx, dy) - 0.006 + 0.003 * grain(u, v, 0.03, seed + 4, w), max(w, 0.002)))


@compiled
def fabric(a: Colour, b: Colour, u: float, v: float, seed: float, contrast: float, w: float) -> Colour:
    """A plain weave of 8 mm with thick and thin threads, and some wear."""
    weave = np.sin(u * 785.0) * np.sin(v * 785.0) * fade(0.008, w) * 0.3
    thread = 0.5 * (noise(u * 12.0, v * 180.0, seed) - 0.5) * fade(0.011, w) + 0.5 * (noise(u * 180.0, v * 12.0, seed + 1) - 0.5) * fade(
        0.011, w
    )
    t = 0.4 + contrast * (weave + thread + 0.35 * grain(u, v, 0.03, seed + 2, w) + 0.35 * grain(u, v, 0.11, seed + 3, w))
    return mix(a, b, min(max(t, 0.0), 1.0))


@compiled
def stripes(a: Colour, b: Colour, c: Colour, scale: float, u: float, v: float, seed: float, contrast: float, w: float) -> Colour:
    """Woven stripes along v: a broad one of B and a narrow one of C on A."""
    x = (u / scale - np.floor(u / scale)) * scale
    soft = max(w, 0.002)
    t = band(x, 0.1 * scale, 0.45 * scale, soft)
    base = mix(mix(a, b, t), c, band(x, 0.62 * scale, 0.72 * scale, soft))
    return mix(base, fabric(scaled(base, 0.6), scaled(base, 1.4), u, v, seed, contrast, w), 0.8)


@compiled
def rug(a: Colour, b: Colour, c: Colour, u: float, v: float, su: float, sv: float, seed: float, w: float) -> Colour:
    """Borders around a field of diamonds with a medallion."""
    x, y = u - su / 2, v - sv / 2
    border = min(su / 2 - abs(x), sv / 2 - abs(y))
    soft = max(w, 0.004)
    cell = 0.22
    p, q = (x + y) / cell, (x - y) / cell
    fp, fq = abs(p - np.floor(p) - 0.5), abs(q - np.floor(q) - 0.5)
    k = random(np.floor(p), np.floor(q), seed)
    base = mix(a, palette(np.floor(4 * k), seed), band(max(fp, fq) * cell, 0.045, 0.075, soft))
    base = mix(base, c, edge(0.03 - max(fp, fq) * cell, soft))
    rho = np.sqrt((x / su) ** 2 + (y / sv) ** 2) * min(su, sv)
    petals = rho * (1 + 0.13 * np.cos(12 * np.arctan2(y * su, x * sv)))
    base = mix(mix(mix(base, b, edge(0.3 - petals, soft)), c, edge(0.22 - petals, soft)), a, edge(0.12 - petals, soft))
    z = (abs(x) if sv / 2 - abs(y) < su / 2 - abs(x) else abs(y)) / 0.09
    tooth = abs(z - np.floor(z) - 0.5) * 0.09
    base = mix(base, b, edge(0.19 - border, soft))
    base = mix(base, c, band(border, 0.05, 0.05 + 0.09 * (0.3 + tooth / 0.045 * 0.7), soft))
    base = mix(base, a, edge(0.02 - border, soft))
    pile = 1 + 0.35 * grain(u, v, 0.006, seed + 1, w) + 0.25 * grain(u, v, 0.05, seed + 2, w) + 0.2 * grain(u, v, 0.2, seed + 3, w)
    return scaled(base, pile)


@compiled
def book(a: Colour, b: Colour, c: Colour, chart: int, u: float, v: float, su: float, sv: float, seed: float, w: float) -> Colour:
    """Spine and boards with bands and a title of blocks; pages on top and below."""
    soft = max(w, 0.0015)
    if chart >= 4:
        line = 0.25 * np.sin(u * 2500.0) * fade(0.0025, w)
        return scaled((0.75, 0.7, 0.58), 0.85 + line + 0.2 * grain(u, v, 0.004, seed, w))
    base = scaled(a, 1 + 0.25 * grain(u, v, 0.012, seed, w))
    if random(1, 1, seed) < 0.7:
        low = sv * (0.06 + 0.1 * random(2, 1, seed))
        base = mix(base, c, band(v, low, low + 0.012, soft) + band(sv - v, low, low + 0.012, soft))
    if random(3, 1, seed) < 0.5:
        base = mix(base, b, band(v, sv * 0.62, sv * 0.85, soft))
    letter = np.floor(v / 0.009)
    ink = random(letter, np.floor(2.5 * u / su), seed) < 0.6 and sv * 0.28 < v < sv * 0.58
    title = (1.0 if ink else 0.0) * band(u, 0.25 * su, 0.75 * su, soft) * fade(0.018, w)
    return mix(base, c, title)


@compiled
def poster(a: Colour, b: Colour, u: float, v: float, su: float, sv: float, seed: float, w: float) -> Colour:
    """An abstract composition on a ground of two colours, in a white mount."""
    soft = max(w, 0.0015)
    base = mix(a, b, min(max(v / sv + 0.3 * grain(u, v, 0.15, seed, w), 0.0), 1.0))
    size = min(su, sv)
    for k in range(9):
        x, y = u - su * random(k, 1, seed), v - sv * random(k, 2, seed)
        r = size * (0.05 + 0.2 * random(k, 3, seed))
        if x * x + y * y > (2.6 * r + soft) ** 2:  # farther out than the longest shape
            continue
        turn = 3.1416 * random(k, 4, seed)
        p, q = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        kind = random(k, 5, seed)
        if kind < 0.35:
            d = r - np.sqrt(x * x + y * y)
        elif kind < 0.55:
            d = 0.15 * r - abs(r - np.sqrt(x * x + y * y))
        elif kind < 0.8:
            d = min(r - abs(p), 0.5 * r - abs(q))
        else:
            d = min(2.5 * r - abs(p), 0.12 * r - abs(q))
        base = mix(base, palette(float(k), seed + 5), edge(d, soft))
    base = scaled(base, 1 + 0.15 * grain(u, v, 0.008, seed + 6, w) + 0.1 * grain(u, v, 0.03, seed + 7, w))
    inside = min(min(u, su - u), min(v, sv - v))
    return mix((0.75, 0.73, 0.68), base, edge(inside - 0.09 * size, soft))


@compiled
def landscape(a: Colour, b: Colour, c: Colour, u: float, v: float, su: float, sv: float, seed: float, w: float) -> Colour:
    """Sky from A (horizon) to B with clouds, four ridges of hills from far to near towards C."""
    x, y = u / sv, v / sv
    soft = max(w, 0.002) / sv
    cloud = noise(x * 4, y * 9, seed) * 0.6 + noise(x * 9, y * 20, seed + 1) * 0.4
    base = mix(mix(a, b, min(max((y - 0.35) * 1.6, 0.0), 1.0)), (0.9, 0.9, 0.88), min(max((cloud - 0.5) * 3, 0.0), 1.0) * 0.7)
    for k in range(4):
        f = 2.0 + 1.5 * k
        ridge = 0.55 - 0.12 * k + 0.16 * (noise(x * f, k, seed + 2) - 0.5) + 0.03 * (noise(x * f * 9, k, seed + 3) - 0.5) * k
        tone = 0.9 + 0.1 * k * (grain(u, v * 1.5, 0.05 * sv, seed + 4 + k, w) + grain(u, v, 0.015 * sv, seed + 8 + k, w))
        base = mix(base, scaled(mix(mix(a, c, 0.45), c, k / 3.0), tone), edge(ridge - y, soft))
    return base


@compiled
def wallpaper(a: Colour, b: Colour, c: Colour, scale: float, u: float, v: float, seed: float, w: float) -> Colour:
    """Flowers in half drop, small sprigs between them, all a little different in tone."""
    i = np.floor(u / scale)
    j = np.floor(v / scale + 0.5 * (i % 2))
    x, y = u - (i + 0.5) * scale, v - (j + 0.5 - 0.5 * (i % 2)) * scale
    soft = max(w, 0.003)
    rho = np.sqrt(x * x + y * y)
    p, q = abs(x) - 0.5 * scale, abs(y)
    leaf = 0.11 * scale - np.sqrt(p * p * 3 + q * q * 0.6)
    f = fade(0.8 * scale, w)
    base = scaled(a, 1 + 0.07 * grain(u, v, 0.025, seed + 3, w) + 0.06 * grain(u, v, 0.3, seed + 4, w))
    base = mix(base, c, f * edge(leaf, soft) * 0.8)
    if rho > 0.27 * scale + soft:  # farther out than the longest petal
        return base
    theta = np.arctan2(y, x) + 6.28 * random(i, j, seed)
    petals = 0.27 * scale * (0.72 + 0.28 * np.cos((4 + np.floor(3 * random(i, j, seed + 1))) * theta))
    base = mix(base, scaled(b, 0.75 + 0.5 * random(i, j, seed + 2)), f * edge(petals - rho, soft))
    return mix(base, c, f * edge(0.07 * scale - rho, soft))


@compiled
def marble(a: Colour, b: Colour, u: float, v: float, seed: float, contrast: float, w: float) -> Colour:
    """Veins where a warped wave crosses zero."""
    warp = noise(u * 4, v * 4, seed) * 3 + noise(u * 11, v * 11, seed + 1)
    vein = 1 - min(abs(np.sin(5 * u + 7 * v + 2.5 * warp)) * 5, 1.0)
    t = 0.15 + contrast * (0.7 * vein * fade(0.05, w) + 0.4 * grain(u, v, 0.05, seed + 2, w) + 0.2 * grain(u, v, 0.012, seed + 3, w))
    return mix(a, b, min(max(t, 0.0), 1.0))


@compiled
def glaze(a: Colour, b: Colour, c: Colour, kind: float, u: float, v: float, sv: float, seed: float, w: float) -> Colour:
    """Pottery: rings of B, and around the middle a zigzag, dots or leaves of C, or nothing (`kind` 0 to 3)."""
    y = v / sv
    soft = max(w, 0.0015)
    base = scaled(a, 1 + 0.25 * grain(u, v, 0.03, seed, w) + 0.2 * grain(u, v, 0.008, seed + 1, w))
    rings = band(y, 0.22, 0.28, soft / sv) + band(y, 0.72, 0.78, soft / sv) + band(y, 0.84, 0.87, soft / sv)
    base = mix(base, b, min(rings, 1.0))
    x = u / 0.05
    wave = 2 * abs(x - np.floor(x) - 0.5)
    if kind == 0:
        d = 0.012 - abs(y - 0.37 - 0.25 * wave) * sv
    elif kind == 1:
        d = 0.013 - np.sqrt((0.5 * (1 - wave) * 0.05) ** 2 + ((y - 0.5) * sv) ** 2)
    elif kind == 2:
        d = 0.018 - 0.025 * (1 - wave) * 1.6 - abs(y - 0.5) * sv * 0.35
    else:
        return base
    return mix(base, c, edge(d, soft) * fade(0.05, w))


@compiled
def plaster(a: Colour, contrast: float, u: float, v: float, seed: float, w: float) -> Colour:
    """Paint laid on by hand: clouds, roller marks, specks."""
    t = 0.3 * grain(u, v, 0.5, seed, w) + 0.3 * grain(u, v, 0.09, seed + 1, w) + 0.4 * grain(u, v, 0.022, seed + 2, w)
    return scaled(a, 1 + contrast * t)


@compiled
def leaves(a: Colour, b: Colour, s: float, t: float, seed: float, contrast: float) -> Colour:
    """A leaf with a midrib and side veins."""
    rib = 1 - min(abs(s - 0.5) * 12, 1.0)
    veins = 0.5 + 0.5 * np.sin(60 * (t + 0.6 * abs(s - 0.5)))
    return mix(a, b, min(max(0.3 + contrast * (0.5 * rib + 0.3 * veins + 0.5 * noise(s * 6, t * 9, seed) - 0.4), 0.0), 1.0))


@compiled
def albedo(materials: NDArray[np.float64], m: int, chart: int, s: float, t: float, su: float, sv: float, seed: float, w: float) -> Colour:
    """Linear RGB of a material at (s, t) of a chart of su x sv metres, seen by a pixel of w metres."""
    pattern, scale, contrast = int(materials[m, 0]), materials[m, 1], materials[m, 2]
    a = (materials[m, 4], materials[m, 5], materials[m, 6])
    b = (materials[m, 7], materials[m, 8], materials[m, 9])
    c = (materials[m, 10], materials[m, 11], materials[m, 12])
    u, v = s * su, t * sv
    if pattern == PAINT:
        return plaster(a, contrast, u, v, seed, w)
    if pattern == WOOD:
        return wood(a, b, u, v, seed, contrast, w) if su >= sv else wood(a, b, v, u, seed, contrast, w)
    if pattern == PLANKS:
        return planks(a, b, c, scale, u, v, seed, contrast, w)
    if pattern == TILES:
        return tiles(a, b, c, scale, u, v, seed, contrast, w)
    if pattern == FABRIC:
        return fabric(a, b, u, v, seed, contrast, w)
    if pattern == STRIPES:
        return stripes(a, b, c, scale, u, v, seed, contrast, w)
    if pattern == RUG:
        return rug(a, b, c, u, v, su, sv, seed, w)
    if pattern == BOOK:
        return book(a, b, c, chart, u, v, su, sv, seed, w)
    return _more_albedo(materials, m, a, b, c, s, t, su, sv, seed, w)


@compiled
def _more_albedo(
    materials: NDArray[np.float64], m: int, a: Colour, b: Colour, c: Colour, s: float, t: float, su: float, sv: float, seed: float, w: float
) -> Colour:
    """The second half of the patterns."""
    pattern, scale, contrast = int(materials[m, 0]), materials[m, 1], materials[m, 2]
    u, v = s * su, t * sv
    if pattern == POSTER:
        return poster(a, b, u, v, su, sv, seed, w)
    if pattern == LANDSCAPE:
        return landscape(a, b, c, u, v, su, sv, seed, w)
    if pattern == WALLPAPER:
        return wallpaper(a, b, c, scale, u, v, seed, w)
    if pattern == BRICKS:
        return bricks(a, b, c, scale, u, v, seed, contrast, w)
    if pattern == MARBLE:
        return marble(a, b, u, v, seed, contrast, w)
    if pattern == LEAVES:
        return leaves(a, b, s, t, seed, contrast)
    return glaze(a, b, c, contrast, u, v, sv, seed, w)
