"""The small network on the feature grid, on the CPU: one hidden layer, T-SDF and colour, compiled by Numba.

The network's arithmetic is small. Writing every layer's output to memory and waking threads for every layer would cost more. Here points
pass forward and backward through the whole network in blocks that stay in the first-level cache. Blocks are transposed, so that each loop
runs over points and vectorises. `tests/test_compiled_field.py` compares it with torch's autograd.

Sums over points are computed in a fixed number of parts, whatever the number of threads, so that results repeat exactly. Helpers are
inlined by force for the same reason (`numba_grid`).
"""

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from idfslam.mapping.kernels.numba_grid import locate, stage, trilinear

Floats = NDArray[np.float32]

BLOCK = 64  # points in a block, whose activations fill half of the first-level cache. More: they no longer fit
PARTS = 8  # separate sums of the weights' gradients, one for each thread at most. More: more memory to add up

_ZERO, _ONE = np.float32(0), np.float32(1)
_FASTMATH = {"contract", "reassoc", "nsz", "arcp"}

_inlined = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", forceinline=True)
_parallel = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", parallel=True)


@_inlined
def _transpose(rows: Floats, start: int, count: int, columns: Floats) -> None:
    """Copies rows start .. start + count of (N, K) to columns of (K, BLOCK). The rest of the block is zero."""
    for i in range(count):
        for k in range(columns.shape[0]):
            columns[k, i] = rows[start + i, k]
    for k in range(columns.shape[0]):
        for i in range(count, BLOCK):
            columns[k, i] = _ZERO


@_inlined
def _add_product(weight: Floats, x: Floats, y: Floats) -> None:
    """y (O, BLOCK) += weight (O, K) x (K, BLOCK), four by four weights at a time, so that each loaded vector is used four times.

    O and K are multiples of four. The compiler compiles a copy at each call, so small products have a loop of their own (`head`).
    """
    for o in range(0, weight.shape[0], 4):
        for k in range(0, weight.shape[1], 4):
            a0, a1, a2, a3 = weight[o, k], weight[o, k + 1], weight[o, k + 2], weight[o, k + 3]
            b0, b1, b2, b3 = weight[o + 1, k], weight[o + 1, k + 1], weight[o + 1, k + 2], weight[o + 1, k + 3]
            c0, c1, c2, c3 = weight[o + 2, k], weight[o + 2, k + 1], weight[o + 2, k + 2], weight[o + 2, k + 3]
            d0, d1, d2, d3 = weight[o + 3, k], weight[o + 3, k + 1], weight[o + 3, k + 2], weight[o + 3, k + 3]
            for p in range(BLOCK):
                x0, x1, x2, x3 = x[k, p], x[k + 1, p], x[k + 2, p], x[k + 3, p]
                y[o, p] += a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3
                y[o + 1, p] += b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3
                y[o + 2, p] += c0 * x0 + c1 * x1 + c2 * x2 + c3 * x3
                y[o + 3, p] += d0 * x0 + d1 * x1 + d2 * x2 + d3 * x3


@_inlined
def linear(weight: Floats, bias: Floats, x: Floats, y: Floats) -> None:
    """y (O, BLOCK) = weight (O, K) x (K, BLOCK) + bias (O,) of a hidden layer."""
    for o in range(len(bias)):
        for p in range(BLOCK):
            y[o, p] = bias[o]
    _add_product(weight, x, y)


@_inlined
def head(weight: Floats, bias: Floats, x: Floats, y: Floats) -> None:
    """`linear` for a layer with few outputs."""
    for o in range(len(bias)):
        for p in range(BLOCK):
            y[o, p] = bias[o]
        for k in range(0, weight.shape[1], 4):
            a, b, c, d = weight[o, k], weight[o, k + 1], weight[o, k + 2], weight[o, k + 3]
            for p in range(BLOCK):
                y[o, p] += a * x[k, p] + b * x[k + 1, p] + c * x[k + 2, p] + d * x[k + 3, p]


@_inlined
def relu(x: Floats) -> None:
    for k in range(x.shape[0]):
        for p in range(BLOCK):
            x[k, p] = max(x[k, p], _ZERO)


@_inlined
def _linear_back(transposed: Floats, g_y: Floats, g_x: Floats) -> None:
    """g_x (K, BLOCK) = weight^T (K, O) g_y (O, BLOCK) of a hidden layer."""
    for k in range(len(g_x)):
        for p in range(BLOCK):
            g_x[k, p] = _ZERO
    _add_product(transposed, g_y, g_x)


@_inlined
def _head_back(weight: Floats, g_y: Floats, g_x: Floats) -> None:
    """`_linear_back` for a layer with few outputs and weight (O, K)."""
    for k in range(len(g_x)):
        for p in range(BLOCK):
            g_x[k, p] = _ZERO
        for o in range(len(g_y)):
            for p in range(BLOCK):
                g_x[k, p] += weight[o, k] * g_y[o, p]


@_inlined
def _masked(g: Floats, activation: Floats) -> None:
    """Sets the gradient to zero where relu was not active."""
    for k in range(g.shape[0]):
        for p in range(BLOCK):
            g[k, p] = g[k, p] if activation[k, p] > _ZERO else _ZERO


@_inlined
def _bias_gradient(g_y: Floats, g_bias: Floats) -> None:
    for o in range(len(g_bias)):
        total = _ZERO
        for p in range(BLOCK):
            total += g_y[o, p]
        g_bias[o] += total


@_inlined
def _weight_gradient(g_y: Floats, x: Floats, g_weight: Floats) -> None:
    """Adds g_y (O, BLOCK) x^T to g_weight (O, K) of a hidden layer, two rows by four columns at a time."""
    for o in range(0, g_weight.shape[0], 2):
        for k in range(0, g_weight.shape[1], 4):
            a0, a1, a2, a3 = _ZERO, _ZERO, _ZERO, _ZERO
            b0, b1, b2, b3 = _ZERO, _ZERO, _ZERO, _ZERO
            for p in range(BLOCK):
                g, h = g_y[o, p], g_y[o + 1, p]
                x0, x1, x2, x3 = x[k, p], x[k + 1, p], x[k + 2, p], x[k + 3, p]
                a0, a1, a2, a3 = a0 + g * x0, a1 + g * x1, a2 + g * x2, a3 + g * x3
                b0, b1, b2, b3 = b0 + h * x0, b1 + h * x1, b2 + h * x2, b3 + h * x3
            g_weight[o, k] += a0
            g_weight[o, k + 1] += a1
            g_weight[o, k + 2] += a2
            g_weight[o, k + 3] += a3
            g_weight[o + 1, k] += b0
            g_weight[o + 1, k + 1] += b1
            g_weight[o + 1, k + 2] += b2
            g_weight[o + 1, k + 3] += b3


@_inlined
def _head_gradient(g_y: Floats, x: Floats, g_weight: Floats) -> None:
    """`_weight_gradient` for a layer with few outputs."""
    for o in range(g_weight.shape[0]):
        for k in range(g_weight.shape[1]):
            total = _ZERO
            for p in range(BLOCK):
                total += g_y[o, p] * x[k, p]
            g_weight[o, k] += total


@_inlined
def _sigmoid(x: Floats) -> None:
    for k in range(x.shape[0]):
        for p in range(BLOCK):
            x[k, p] = _ONE / (_ONE + np.exp(-x[k, p]))


@_inlined
def gather(xyz, count, tables, inverse, lanes, e, fraction, x) -> None:  # type: ignore[no-untyped-def]
    """Fills the grid's features x (K, BLOCK) at the points xyz (3, BLOCK). e (8, BLOCK), fraction (3, BLOCK): overwritten."""
    width, mask = len(lanes), np.uint32(tables.shape[1] - 1)
    for level in range(len(tables)):
        t = tables[level]
        locate(xyz, count, inverse[level], mask, e, fraction)
        for i in range(count):
            u, v, w = fraction[0, i], fraction[1, i], fraction[2, i]
            e0, e1, e2, e3, e4, e5, e6, e7 = e[0, i], e[1, i], e[2, i], e[3, i], e[4, i], e[5, i], e[6, i], e[7, i]
            for f in range(width):
                x[level * width + f, i], _, _, _ = trilinear(
                    t[e0, f], t[e1, f], t[e2, f], t[e3, f], t[e4, f], t[e5, f], t[e6, f], t[e7, f], u, v, w
                )


@_inlined
def gather_slopes(xyz, count, tables, inverse, lanes, e, fraction, x, slopes) -> None:  # type: ignore[no-untyped-def]
    """`gather`, and the features' slopes (K, 3, BLOCK) by the place in metres."""
    width, mask = len(lanes), np.uint32(tables.shape[1] - 1)
    for level in range(len(tables)):
        t, cells = tables[level], inverse[level]
        locate(xyz, count, cells, mask, e, fraction)
        for i in range(count):
            u, v, w = fraction[0, i], fraction[1, i], fraction[2, i]
            e0, e1, e2, e3, e4, e5, e6, e7 = e[0, i], e[1, i], e[2, i], e[3, i], e[4, i], e[5, i], e[6, i], e[7, i]
            for f in range(width):
                k = level * width + f
                feature, du, dv, dw = trilinear(t[e0, f], t[e1, f], t[e2, f], t[e3, f], t[e4, f], t[e5, f], t[e6, f], t[e7, f], u, v, w)
                x[k, i] = feature
                slopes[k, 0, i], slopes[k, 1, i], slopes[k, 2, i] = du * cells, dv * cells, dw * cells


@_parallel
def infer(features, w1, b1, ws, bs, sdf) -> None:  # type: ignore[no-untyped-def]
    """Fills sdf (N,) [tr] from features (N, K)."""
    for block in prange((len(features) + BLOCK - 1) // BLOCK):
        start = block * BLOCK
        count = min(len(features) - start, BLOCK)
        x, h = np.empty((w1.shape[1], BLOCK), np.float32), np.empty((w1.shape[0], BLOCK), np.float32)
        s = np.empty((1, BLOCK), np.float32)
        _transpose(features, start, count, x)
        linear(w1, b1, x, h)
        relu(h)
        head(ws, bs, h, s)
        for p in range(count):
            sdf[start + p] = s[0, p]


@_parallel
def distance(points, grid, network, scale, value, gradient) -> None:  # type: ignore[no-untyped-def]
    """Fills scale * T-SDF (N,) and its gradient (N, 3) at points (N, 3). Grid and network are one loop, so slopes stay in the cache.

    grid: tables (L, T, F), cells per metre (L,), and a tuple as long as an entry has features. network: weight and bias of the hidden
    layer and of the head.
    """
    tables, inverse, lanes = grid
    w1, b1, ws, bs = network
    inputs, hidden = w1.shape[1], w1.shape[0]
    w1_t = w1.T.copy()
    for block in prange((len(points) + BLOCK - 1) // BLOCK):
        start = block * BLOCK
        count = min(len(points) - start, BLOCK)
        e, xyz, fraction = np.empty((8, BLOCK), np.uint32), np.empty((3, BLOCK), np.float32), np.empty((3, BLOCK), np.float32)
        x, g_x = np.zeros((inputs, BLOCK), np.float32), np.empty((inputs, BLOCK), np.float32)
        slopes = np.empty((inputs, 3, BLOCK), np.float32)
        h, s = np.empty((hidden, BLOCK), np.float32), np.empty((1, BLOCK), np.float32)
        stage(points, start, count, xyz)
        gather_slopes(xyz, count, tables, inverse, lanes, e, fraction, x, slopes)
        linear(w1, b1, x, h)
        relu(h)
        head(ws, bs, h, s)
        for k in range(hidden):
            for p in range(BLOCK):
                h[k, p] = ws[0, k] if h[k, p] > _ZERO else _ZERO
        _linear_back(w1_t, h, g_x)
        for axis in range(3):
            for p in range(BLOCK):
                xyz[axis, p] = _ZERO
            for k in range(inputs):
                for p in range(BLOCK):
                    xyz[axis, p] += g_x[k, p] * slopes[k, axis, p]
        for p in range(count):
            value[start + p] = scale * s[0, p]
            for axis in range(3):
                gradient[start + p, axis] = scale * xyz[axis, p]


@_inlined
def _surface_loss(s, start, count, near, target, weight, margin, loss) -> None:  # type: ignore[no-untyped-def]
    """The losses of a block's T-SDF s (1, BLOCK), which their slopes replace: by targets near the surface, by the margin in free space."""
    for p in range(count):
        residual = s[0, p] - target[start + p] if near else min(s[0, p] - margin, _ZERO)
        loss[start + p] = weight[start + p] * residual * residual
        s[0, p] = np.float32(2) * weight[start + p] * residual
    for p in range(count, BLOCK):
        s[0, p] = _ZERO


@_inlined
def _colour_loss(o, start, count, target, weight, loss) -> None:  # type: ignore[no-untyped-def]
    """The losses of a block's colours o (3, BLOCK), which their slopes by the values before the sigmoid replace."""
    for p in range(count):
        total = _ZERO
        for k in range(3):
            value = o[k, p]
            difference = value - target[start + p, k]
            total += abs(difference)
            sign = _ONE if difference > _ZERO else -_ONE
            o[k, p] = weight[start + p] / np.float32(3) * sign * value * (_ONE - value)
        loss[start + p] = total / np.float32(3)
    for k in range(3):
        for p in range(count, BLOCK):
            o[k, p] = _ZERO


@_inlined
def _colour_gradient(h, layers, layer1_t, start, count, colours, o, c, g_c, g_more, gradients, loss) -> None:  # type: ignore[no-untyped-def]
    """The losses of a block's colours, forward from h (O, BLOCK) and back to g_more (O, BLOCK). Adds to the layers' gradients."""
    wc1, bc1, wc2, bc2 = layers
    g_wc1, g_bc1, g_wc2, g_bc2 = gradients
    target, weight = colours
    linear(wc1, bc1, h, c)
    relu(c)
    head(wc2, bc2, c, o)
    _sigmoid(o)
    _colour_loss(o, start, count, target, weight, loss)
    _head_gradient(o, c, g_wc2)
    _bias_gradient(o, g_bc2)
    _head_back(wc2, o, g_c)
    _masked(g_c, c)
    _weight_gradient(g_c, h, g_wc1)
    _bias_gradient(g_c, g_bc1)
    _linear_back(layer1_t, g_c, g_more)


@_parallel
def learn(features, near, distances, colours, network, g_features, g_network, losses) -> None:  # type: ignore[no-untyped-def]
    """Fills the losses (N,) of the T-SDF and (near,) of colour, and the gradients of the sum of `loss` and `weight colour_loss`.

    features: (N, K). The first `near` samples are near the surface: loss = weight (target - s)^2, and colour_loss is the mean absolute
    difference of colour. The others are in free space: loss = weight max(margin - s, 0)^2. distances: targets (N,), weights (N,) and the
    margin [tr]. colours: targets (near, 3) and weights (near,). network: weight and bias of the hidden layer, the head and the two layers
    of colour. g_network: their gradients, as PARTS separate sums.
    """
    target, weight, margin = distances
    w1, b1, ws, bs, wc1, bc1, wc2, bc2 = network
    g_w1, g_b1, g_ws, g_bs, g_wc1, g_bc1, g_wc2, g_bc2 = g_network
    loss, colour_loss = losses
    inputs, hidden, width = w1.shape[1], w1.shape[0], wc1.shape[0]
    w1_t, wc1_t = w1.T.copy(), wc1.T.copy()
    near_blocks = (near + BLOCK - 1) // BLOCK
    blocks = near_blocks + (len(features) - near + BLOCK - 1) // BLOCK
    for part in prange(PARTS):
        x, h, g_h = np.empty((inputs, BLOCK), np.float32), np.empty((hidden, BLOCK), np.float32), np.empty((hidden, BLOCK), np.float32)
        c, g_c, o = np.empty((width, BLOCK), np.float32), np.empty((width, BLOCK), np.float32), np.empty((3, BLOCK), np.float32)
        g_x, s, g_more = np.empty((inputs, BLOCK), np.float32), np.empty((1, BLOCK), np.float32), np.empty((hidden, BLOCK), np.float32)
        for block in range(part, blocks, PARTS):
            is_near = block < near_blocks
            start = block * BLOCK if is_near else near + (block - near_blocks) * BLOCK
            count = min((near if is_near else len(features)) - start, BLOCK)
            _transpose(features, start, count, x)
            linear(w1, b1, x, h)
            relu(h)
            head(ws, bs, h, s)
            _surface_loss(s, start, count, is_near, target, weight, margin, loss)
            _head_gradient(s, h, g_ws[part])
            _bias_gradient(s, g_bs[part])
            for k in range(hidden):
                for p in range(BLOCK):
                    g_h[k, p] = ws[0, k] * s[0, p]
            if is_near:
                layers, gradients = (wc1, bc1, wc2, bc2), (g_wc1[part], g_bc1[part], g_wc2[part], g_bc2[part])
                _colour_gradient(h, layers, wc1_t, start, count, colours, o, c, g_c, g_more, gradients, colour_loss)
                for k in range(hidden):
                    for p in range(BLOCK):
                        g_h[k, p] += g_more[k, p]
            _masked(g_h, h)
            _weight_gradient(g_h, x, g_w1[part])
            _bias_gradient(g_h, g_b1[part])
            _linear_back(w1_t, g_h, g_x)
            for p in range(count):
                for k in range(inputs):
                    g_features[start + p, k] = g_x[k, p]


@njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy")
def adam(x, parts, m, v, step_size, beta1, beta2, correction, eps) -> None:  # type: ignore[no-untyped-def]
    """One step of Adam on weights x (N,) whose gradient is the sum of parts (PARTS, N). The parts are zero afterwards."""
    for i in range(len(x)):
        g = _ZERO
        for part in range(len(parts)):
            g += parts[part, i]
            parts[part, i] = _ZERO
        m[i] = beta1 * m[i] + (_ONE - beta1) * g
        v[i] = beta2 * v[i] + (_ONE - beta2) * g * g
        x[i] -= step_size * m[i] / (np.sqrt(v[i]) * correction + eps)
