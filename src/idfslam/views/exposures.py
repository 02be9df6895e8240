"""The exposures of archived images, so that colours of several can be mixed, and a mesh has those of one exposure.

Each image is compared with the nearest ones at the places that both see (`sensing/light_comparison.py`), and all exposures are solved for
together (`sensing/light_solution.py`).
"""

from collections.abc import Iterable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.depth_view import DepthView
from idfslam.geometry.pose_distance import apparent_motions
from idfslam.sensing.depth_edges import EDGE, EDGE_SHARE
from idfslam.sensing.light_comparison import Comparison, compare
from idfslam.sensing.light_solution import exposure_changes, exposures
from idfslam.sensing.vignette import TERMS

Floats = NDArray[np.float64]

_NEAREST = 2  # earlier and later images with which each is compared. More: slower, and surer where some do not overlap. Chosen by hand
_STEP = 3  # [px] of the depth images: every third place is compared. More: faster, and less sure. Chosen by hand
_NOISE = 0.01  # [1] standard deviation of a colour of such a small image. More: flat places count less against slopes. Chosen by hand
_SLIP = 0.7  # [px] by which two views miss one another. More: places on slopes of brightness count less. As in the estimation of light


def solve_exposures(colours: Iterable[NDArray[np.uint8]], depths: Sequence[DepthView]) -> Floats:
    """The logarithm of the gain, and the offset, of each channel of V images, (V, 3, 2): colour = gain (scene + offset).

    Those of the first image are 0, and so are all where the exposure does not change. colours: (H, W, 3). depths: of the same cameras.
    """
    poses = np.stack([view.T_wc for view in depths])
    small = [_small(colour, view) for colour, view in zip(colours, depths)]
    pairs, comparisons = list[tuple[int, int]](), list[Comparison]()
    for a in range(1, len(depths)):
        for b in np.argsort(apparent_motions(poses[a], poses[:a]), kind="stable")[:_NEAREST]:
            if (found := _compare(small[a], depths[a], small[b], depths[b])) is not None:
                pairs.append((a, int(b)))
                comparisons.append(found)
    if not exposure_changes(comparisons, None):
        return np.zeros((len(depths), 3, 2))
    return exposures(pairs, comparisons, len(depths), None)


def _small(colour: NDArray[np.uint8], view: DepthView) -> NDArray[np.float32]:
    """Colour and the slope of its brightness (h, w, 4), in the size of the depth image."""
    size = view.depth.shape[::-1]
    image = cv2.resize(colour, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
    grey = image.mean(-1)
    slope = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=1 / 8))
    return np.concatenate([image, slope[..., None]], -1)


def _compare(a: NDArray[np.float32], of_a: DepthView, b: NDArray[np.float32], of_b: DepthView) -> Comparison | None:
    """Compares the places of image a that image b sees too; None if they are too few."""
    v, u = np.nonzero(of_a.depth[::_STEP, ::_STEP] > 0)
    v, u = v * _STEP, u * _STEP
    c, z = of_a.camera, of_a.depth[v, u].astype(np.float64)
    points = np.stack([(u - c.cx) / c.fx * z, (v - c.cy) / c.fy * z, z], -1)
    T_ba = np.linalg.inv(of_b.T_wc) @ of_a.T_wc
    x, y, z_b = (points @ T_ba[:3, :3].T + T_ba[:3, 3]).T
    c = of_b.camera
    ahead = np.maximum(z_b, 1e-6)
    u_b, v_b = np.rint(x / ahead * c.fx + c.cx), np.rint(y / ahead * c.fy + c.cy)
    inside = (z_b > 0) & (u_b >= 0) & (u_b < c.width) & (v_b >= 0) & (v_b < c.height)
    u, v, z_b = u[inside], v[inside], z_b[inside]
    u_b, v_b = u_b[inside].astype(int), v_b[inside].astype(int)
    read = of_b.depth[v_b, u_b]
    seen = (read > 0) & (np.abs(read - z_b) < EDGE + EDGE_SHARE * z_b)
    of_places_a, of_places_b = a[v[seen], u[seen]].astype(np.float64), b[v_b[seen], u_b[seen]].astype(np.float64)
    noise = np.sqrt(2 * _NOISE**2 + _SLIP**2 * (of_places_a[:, 3] ** 2 + of_places_b[:, 3] ** 2))
    none = np.zeros((len(noise), TERMS))
    return compare(of_places_a[:, :3], of_places_b[:, :3], none, none, noise)
