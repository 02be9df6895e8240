"""Exposure of each keyframe and vignetting of the recording, estimated from the colours of places that several keyframes see.

The map learns colours that are brought to one exposure. Otherwise it would learn a mean of all exposures in which a place was seen.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from idfslam.compute.backend import pick
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.geometry.projection import intrinsics_of
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.keyframe_images import Images
from idfslam.sensing.depth_edges import EDGE, EDGE_SHARE
from idfslam.sensing.light import Light
from idfslam.sensing.light_comparison import Comparison, compare
from idfslam.sensing.light_solution import differ, exposure_changes, exposure_over, exposures, vignette
from idfslam.sensing.shared_places import fill_shared
from idfslam.sensing.vignette import TERMS, Vignette, even_powers
from idfslam.slam.keyframe_hook import KeyframeHook, Moved
from idfslam.storage.state import State

Array = NDArray[np.float64]
Columns = list[Array]

# All of these were chosen by hand.
_ROWS = 120  # of the images that are compared: means of pixels have little noise. More: slower, and exacter near edges
_STRIDE = 3  # [pixels] every so many of them are compared. More: faster, and noisier. Neighbours err together, so little is lost
_REFERENCES = 2  # the oldest and the newest so many covisible keyframes are compared with. More: slower, and surer
_NOISE = 0.005  # [1] standard deviation of a colour in such an image. More: flat places count less against places with a slope
_SLIP = 0.7  # [px] of such an image by which two views miss one another. More: places on slopes of brightness count less


@dataclass(frozen=True)
class _Places:
    """N pixels of a small image that are compared with others."""

    points: Tensor  # (N, 3) [m] in the keyframe's frame
    colour: Tensor  # (N, 3)
    powers: Tensor  # (N, TERMS) `even_powers`
    uncertainty: Tensor  # (N,)


@dataclass(frozen=True)
class _Thumbnail:
    """A small image of a keyframe."""

    camera: Camera
    colour: Tensor  # (3, h, w)
    depth: Tensor  # (h, w) [m], 0: no reading
    uncertainty: Tensor  # (h, w) standard deviation of the colour at a place that another image sees there

    @cached_property
    def places(self) -> _Places:
        """Every `_STRIDE`-th pixel with depth."""
        v, u = (axis[::_STRIDE] for axis in torch.nonzero(self.depth > 0, as_tuple=True))
        uv = torch.stack([u, v], -1).to(self.depth)
        points = self.camera.rays(uv) * self.depth[v, u][:, None]
        return _Places(points, self.colour[:, v, u].T, even_powers(uv, self.camera), self.uncertainty[v, u])


class LightEstimation(KeyframeHook):
    """Compares each new keyframe with covisible ones, and solves for all exposures and the vignetting."""

    def __init__(self, graph: KeyframeGraph, take_out: Callable[[Vignette | None], None] = lambda vignette: None) -> None:
        """take_out: is told the vignetting whenever it has changed noticeably."""
        self.graph, self._take_out = graph, take_out
        self._pairs: list[tuple[int, int]] = []  # stored keyframes that were compared, the newer one first
        self._comparisons: list[Comparison] = []
        self._vignette: Vignette | None = None
        self._changes = False  # whether the exposure changes from image to image
        self._told: Vignette | None = None  # the vignetting that `take_out` was last told
        self._exposures = np.zeros((0, 3, 2))  # log gain and offset of each channel of the stored keyframes
        self._thumbnails: WeakKeyDictionary[Images, _Thumbnail] = WeakKeyDictionary()

    def state(self) -> State:
        """The comparisons, from which exposures and vignetting follow, and the vignetting that was told last."""
        comparisons = [{"normal": torch.from_numpy(c.normal), "right": torch.from_numpy(c.right)} for c in self._comparisons]
        told = [] if self._told is None else list(self._told.coefficients)
        return {"pairs": [list(pair) for pair in self._pairs], "comparisons": comparisons, "count": len(self._exposures), "told": told}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._pairs = [(a, b) for a, b in state["pairs"]]
        self._comparisons = [Comparison(c["normal"].numpy(), c["right"].numpy()) for c in state["comparisons"]]
        self._tell(Vignette(tuple(state["told"])) if state["told"] else None)
        self._solve(state["count"])

    def on_keyframe(self, keyframe: Keyframe) -> Moved:
        """Compares a keyframe, if it was stored, with covisible ones."""
        if self.graph.is_stored(keyframe):
            for i in self._references(keyframe):
                if (comparison := self._comparison(keyframe, self.graph.keyframes[i])()) is not None:
                    self._pairs.append((keyframe.host, i))
                    self._comparisons.append(comparison)
            self._solve(len(self.graph.keyframes))
        return Moved()

    def on_split(self) -> None:
        """Forgets comparisons at poses that were wrong."""
        kept = [k for k, (a, b) in enumerate(self._pairs) if b in self.graph.keyframes[a].edges]
        self._pairs, self._comparisons = [self._pairs[k] for k in kept], [self._comparisons[k] for k in kept]
        self._solve(len(self._exposures))

    def of(self, view: Keyframe) -> Light | None:
        """The light of a view; None if it is that of the first keyframe, without vignetting.

        A view that is no stored keyframe is compared with covisible ones whose exposures stay as they are.
        """
        return self.later(view)()

    def later(self, view: Keyframe) -> Callable[[], Light | None]:
        """`of` at the present poses and exposures, which may change before it is called, in this thread or another."""
        vignette = self._vignette
        if not self._changes:
            return lambda: None if vignette is None else Light(torch.ones(3), torch.zeros(3), vignette)
        if self.graph.is_stored(view) and view.host < len(self._exposures):
            of_view = self._exposures[view.host]
            return lambda: _light(of_view, vignette)
        references = [i for i in self._references(view) if i < len(self._exposures)]
        known = [(self._exposures[i], self._comparison(view, self.graph.keyframes[i])) for i in references]
        return lambda: _light(_estimated(known, vignette), vignette)

    @property
    def vignette(self) -> Vignette | None:
        """The vignetting of the recording; None if there is none, or none that is sure."""
        return self._vignette

    def _solve(self, count: int) -> None:
        self._vignette = vignette(self._comparisons)
        self._changes = exposure_changes(self._comparisons, self._vignette)
        if differ(self._told, self._vignette):
            self._tell(self._vignette)
        self._exposures = exposures(self._pairs, self._comparisons, count, self._vignette)

    def _tell(self, vignette: Vignette | None) -> None:
        self._told = vignette
        self._take_out(vignette)

    def _references(self, view: Keyframe) -> list[int]:
        """Stored keyframes with which a view is compared: the oldest and the newest of those covisible ones whose poses were measured."""
        last = self.graph.last_keyframe
        measured = view.edges or (set() if last is None else last.edges | {last.host})
        known = sorted(i for i in view.covisible & measured if self.graph.keyframes[i] is not view)
        return sorted({*known[:_REFERENCES], *known[-_REFERENCES:]})

    def _comparison(self, a: Keyframe, b: Keyframe) -> Callable[[], Comparison | None]:
        """Compares, when it is called, the places that keyframe a sees and keyframe b sees too, at their present poses."""
        T_ba, of_a, of_b = se3.inverse(b.T_wk) @ a.T_wk, self._thumbnail(a), self._thumbnail(b)

        def compared() -> Comparison | None:
            places = of_a().places
            return compare(*pick(places.points, compiled=compiled_shared, plain=plain_shared)(places, of_b(), T_ba))

        return compared

    def _thumbnail(self, keyframe: Keyframe) -> Callable[[], _Thumbnail]:
        """Makes the small image of a keyframe's present images when it is called, if there is none yet."""
        images, camera = keyframe.images, keyframe.camera

        def made() -> _Thumbnail:
            if images not in self._thumbnails:
                self._thumbnails[images] = thumbnail(images.colour, images.depth, camera)
            return self._thumbnails[images]

        return made


def _light(of_view: Array, vignette: Vignette | None) -> Light:
    """The light of log gains and offsets (3, 2)."""
    return Light(torch.from_numpy(np.exp(of_view[:, 0])).float(), torch.from_numpy(of_view[:, 1]).float(), vignette)


def _estimated(known: Sequence[tuple[Array, Callable[[], Comparison | None]]], vignette: Vignette | None) -> Array:
    """The log gains and offsets (3, 2) of a view, from those of keyframes and its comparisons with them."""
    found = [(of_other, comparison) for of_other, compared in known if (comparison := compared()) is not None]
    if not found:
        return np.zeros((3, 2))
    # Relative to each of them; those differ little among themselves.
    return np.asarray(exposure_over([comparison for _, comparison in found], vignette) + np.mean([of_other for of_other, _ in found], 0))


def compiled_shared(places: _Places, of_b: _Thumbnail, T_ba: Tensor) -> Columns:
    """`plain_shared` by Numba, on the CPU."""
    count = len(places.points)
    columns = [np.empty((count, *width)) for width in ((3,), (3,), (TERMS,), (TERMS,), ())]
    of_a = tuple(column.numpy() for column in (places.points, places.colour, places.powers, places.uncertainty))
    image = of_b.colour.numpy(), of_b.depth.numpy(), of_b.uncertainty.numpy()
    found = fill_shared(of_a, T_ba.numpy(), intrinsics_of(of_b.camera), image, *columns)
    return [column[:found] for column in columns]


def plain_shared(places: _Places, of_b: _Thumbnail, T_ba: Tensor) -> Columns:
    """What `compare` takes of the places of a that b sees too, at the pose T_ba (4, 4) of a: in torch, on any device."""
    uv, z = of_b.camera.project(se3.transform(T_ba.to(places.points), places.points))
    seen = torch.nonzero(of_b.camera.inside(uv, z))[:, 0]
    u, v = uv[seen].round().long().unbind(-1)
    near = (of_b.depth[v, u] - z[seen]).abs() < EDGE + EDGE_SHARE * z[seen]
    seen, u, v = seen[near], u[near], v[near]
    uv = uv[seen]
    noise = (places.uncertainty[seen] ** 2 + of_b.uncertainty[v, u] ** 2).sqrt()
    colour = places.colour[seen], sampled(of_b.colour, uv)
    powers = places.powers[seen], even_powers(uv, of_b.camera)
    return [column.double().cpu().numpy() for column in (*colour, *powers, noise)]


def thumbnail(colour: Tensor, depth: Tensor, camera: Camera) -> _Thumbnail:
    """The small image of colour (H, W, 3) and depth (H, W) [m]."""
    shrink = max(1, camera.height // _ROWS)
    small = pick(colour, compiled=opencv_means, plain=plain_means)(colour, shrink)
    height, width = small.shape[1:]
    rows, columns = ((torch.arange(n, device=depth.device) * shrink + shrink // 2) for n in (height, width))
    z = depth[rows[:, None], columns[None]]
    luminance = small.mean(0)
    slope = torch.zeros_like(luminance)
    slope[:, 1:-1] = (luminance[:, 2:] - luminance[:, :-2]).abs() / 2
    slope[1:-1] = torch.maximum(slope[1:-1], (luminance[2:] - luminance[:-2]).abs() / 2)
    resized = Camera(
        width, height, *(f / shrink for f in (camera.fx, camera.fy)), *((c + 0.5) / shrink - 0.5 for c in (camera.cx, camera.cy))
    )
    return _Thumbnail(resized, small, z, (_NOISE**2 + (_SLIP * slope) ** 2).sqrt())


def plain_means(colour: Tensor, shrink: int) -> Tensor:
    """The means (3, h, w) of `shrink` x `shrink` pixels of an image (H, W, 3), in torch, on any device."""
    return F.avg_pool2d(colour.permute(2, 0, 1)[None], shrink)[0]


def opencv_means(colour: Tensor, shrink: int) -> Tensor:
    """The same by OpenCV, on the CPU."""
    height, width = (size // shrink for size in colour.shape[:2])
    whole = colour.numpy()[: height * shrink, : width * shrink]
    return torch.from_numpy(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)).permute(2, 0, 1).contiguous()


def sampled(image: Tensor, uv: Tensor) -> Tensor:
    """An image (C, h, w) at pixels (N, 2), bilinear, (N, C)."""
    size = uv.new_tensor([image.shape[2], image.shape[1]])
    place = ((uv + 0.5) * (2 / size) - 1)[None, None]
    return F.grid_sample(image[None], place, align_corners=False, padding_mode="border")[0, :, 0].T
