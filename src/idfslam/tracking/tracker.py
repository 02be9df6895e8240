"""The neural tracker (Sec. V): a frame's pose in its reference keyframe by features, matches and robust Procrustes."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.compute.adam import Adam
from idfslam.compute.devices import resolve_precision
from idfslam.compute.torch_threads import unlimited_torch_threads
from idfslam.config import FinetuneConfig, TrackerConfig
from idfslam.errors import ConfigError
from idfslam.frame import Frame, Status
from idfslam.geometry import se3
from idfslam.storage.state import State, Stateful, adam_dict, plain_adam
from idfslam.tracking.correspondences import Correspondences, estimate_pose, is_valid
from idfslam.tracking.features import FeatureExtractor, folded, load_extractor
from idfslam.tracking.finetune_validator import FinetuneValidator, validation_pairs
from idfslam.tracking.finetuning import Render, finetune_step, finetuning_losses
from idfslam.tracking.frame_features import FrameFeatures, brightness, reduced
from idfslam.tracking.matching import Features, PixelMatches, bucket, match
from idfslam.tracking.overlap import overlapping_pixels
from idfslam.tracking.patch_alignment import AlignedPatches
from idfslam.tracking.point_to_plane import point_to_plane
from idfslam.tracking.procrustes import ProcrustesFit, supported
from idfslam.tracking.refined_registration import RefinedRegistration, refined

# [px] Strides of query and target pixels in validation. More: faster, and noisier scores. With these a pair takes a few ms. Chosen by hand.
_QUERY_STRIDE, _TARGET_STRIDE = 8, 2

# [1] Share of inliers among the matches below which more pixels are searched. More: more frequent second searches, at four times the time
_FEW = 0.3
_DENSER = 4  # [1] queries and matches of the second search, relative to the first. More: more views from odd angles are matched, slower
# [1] Patches that convince by themselves: the first, and the second times the share of the depth pixels that disagrees. On 217 pairs of
# different places at most 28 patches agreed, where 91 % of depth disagreed. More: fewer and safer registrations.
_CONVINCING, _CONTRADICTED = 20, 60
# [1] Least patches for a pose of the second search, which finds more accidental matches. More: fewer and safer registrations
_CONFIRMING = 12


@dataclass(frozen=True)
class TrackingResult:
    """A frame's pose in a keyframe, and the evidence for it."""

    T_kc: NDArray[np.float64]  # (4, 4); the identity if there were too few matches
    status: Status  # OK or LOST
    matches: int  # matches that went into the registration
    inliers: int  # inliers among them
    rmse: float  # of the inliers' distances [m]; nan without inliers
    covariance: NDArray[np.float64] | None = None  # (6, 6) of delta, where exp(delta) T_kc is the true pose [m, rad]; None: unknown
    patches: int = 0  # patches of the keyframe's image that the frame shows where the pose projects them
    aligned: AlignedPatches | None = None  # the patches that were found in the frame

    @property
    def convinces(self) -> bool:
        """Whether so many patches confirm the pose that it holds against another source."""
        return self.status is Status.OK and self.patches >= _CONVINCING

    def agrees(self, T_kc: NDArray[np.float64]) -> bool:
        """Whether another pose (4, 4) explains the image about as well: it keeps at least half of the patches that confirm this one."""
        return self.aligned is None or self.aligned.agree(torch.from_numpy(T_kc), torch.from_numpy(self.T_kc))


class Tracker(Stateful):
    """Tracks frames against keyframes. `finetune` adapts the extractor's out-conv to the scene.

    The tracker is deterministic for a given seed. `extractor` replaces the one that the config names. Raises ConfigError if the weights
    cannot be used.
    """

    def __init__(
        self,
        config: TrackerConfig,
        finetune: FinetuneConfig,
        device: torch.device | str = "cpu",
        seed: int = 0,
        *,
        extractor: FeatureExtractor | None = None,
    ) -> None:
        self.config, self.finetuning, self.device = config, finetune, torch.device(device)
        self.generator = torch.Generator().manual_seed(seed)
        self.extractor = (extractor or load_extractor(config.weights)).to(self.device).requires_grad_(False)
        self.dtype = resolve_precision(config.precision, self.device)
        self.inference = folded(self.extractor, self.dtype)
        learning = self.extractor.out_conv.requires_grad_(True)
        self.optimiser = Adam(learning.parameters(), lr=finetune.learning_rate)
        self.validator = FinetuneValidator(learning, self.optimiser, finetune.margin)
        self._steps = 0  # steps of finetuning
        self._registrations = 0  # since the last step of finetuning

    def state(self) -> State:
        """The finetuned weights, their optimiser and the generator, and a checksum of the other weights."""
        learnt = dict(self.extractor.out_conv.state_dict())
        counts = {"steps": self._steps, "registrations": self._registrations}
        optimiser = {"adam": plain_adam(self.optimiser.state_dict()), **counts, "validator": self.validator.state()}
        return {"weights": self._checksum(), "learnt": learnt, "generator": self.generator.get_state(), **optimiser}

    def restore(self, state: State) -> None:
        """Takes over `state`. Raises ConfigError if this tracker was made with other weights."""
        if state["weights"] != self._checksum():
            reason = "the file has changed" if self.config.weights else "this version ships others"
            raise ConfigError(f"the tracker's weights are not those that the run began with ({reason}); start the run anew")
        self.extractor.out_conv.load_state_dict(state["learnt"])
        self.optimiser.load_state_dict(adam_dict(state["adam"]))
        self.validator.restore(state["validator"])
        self._steps, self._registrations = state["steps"], state["registrations"]
        self.generator.set_state(state["generator"])

    def _checksum(self) -> int:
        """Checksum of the frozen weights."""
        total = 0
        for weights in self.inference.state_dict().values():
            total = zlib.crc32(weights.float().cpu().numpy().tobytes(), total)
        return total

    def images(self, frame: Frame) -> FrameFeatures:
        """A frame's images and points at the tracker's resolution, without features: enough for `track_near`."""
        image, depth, camera = reduced(frame, self.config.height)
        colour = torch.from_numpy(image).to(self.device).permute(2, 0, 1)
        points, grey = camera.backproject(torch.from_numpy(depth).to(self.device)), torch.from_numpy(brightness(frame))
        return FrameFeatures(torch.zeros(0, 0, 0, device=self.device), colour, points, camera, frame.camera, grey)

    @torch.no_grad()
    def extract_features(self, frame: Frame | FrameFeatures) -> FrameFeatures:
        """A frame's trunk features, of the frame or of its `images`. The caller keeps them while the frame serves as a reference."""
        images = self.images(frame) if isinstance(frame, Frame) else frame
        with unlimited_torch_threads():
            trunk = self.inference.trunk(images.colour[None].to(self.dtype, memory_format=torch.channels_last))[0]
        return replace(images, trunk=trunk)

    @torch.no_grad()
    def track(self, frame: FrameFeatures, keyframe: FrameFeatures) -> TrackingResult:
        """The frame's pose in the keyframe; LOST if it has too few matches, or is not consistent with matches and depth."""
        self._registrations += 1
        pairs, pose = self.register(frame, keyframe)
        if pose is None:
            return TrackingResult(np.eye(4), Status.LOST, len(pairs), 0, float("nan"))
        return _result(pose, len(pairs), self.is_consistent(pose, pairs, frame, keyframe))

    @torch.no_grad()
    def track_near(self, frame: FrameFeatures, keyframe: FrameFeatures, T_kc: NDArray[np.float64]) -> TrackingResult:
        """The frame's pose near a known T_kc (4, 4), without features: patches of the keyframe alone are found in the frame.

        It costs a fifth of `extract_features` and `track`, and corrects up to about 2 degrees. LOST unless many patches confirm it.
        """
        none = Correspondences.none(self.device)
        start = ProcrustesFit(torch.from_numpy(T_kc).to(self.device), none.weight > 0, float("nan"))
        distance = self.config.inlier_distance
        pose = refined(start, none, frame, keyframe, plane_steps=self.config.plane_steps, inlier_distance=distance)
        if pose is None:
            return TrackingResult(T_kc, Status.LOST, 0, 0, float("nan"))
        return _result(pose, 0, _convincing(pose, overlapping_pixels(pose.T_ab, keyframe, frame).depth_consistency))

    @torch.no_grad()
    def register(self, frame: FrameFeatures, keyframe: FrameFeatures) -> tuple[Correspondences, ProcrustesFit | None]:
        """The best matches of the two, and T_kc by the matches, the images and the depth images; None for too few matches."""
        pairs, pose = self._search(frame, keyframe)
        if pose is None or not bool(pose.inliers.any()):
            return pairs, pose
        steps, distance = self.config.plane_steps, self.config.inlier_distance
        if self.config.patches and (better := refined(pose, pairs, frame, keyframe, plane_steps=steps, inlier_distance=distance)):
            return pairs, better
        if steps == 0:
            return pairs, pose
        T_kc = point_to_plane(pose.T_ab, frame, keyframe, pairs[pose.inliers], steps=steps)
        return pairs, supported(T_kc, pairs.frame, pairs.keyframe, distance)

    def _search(self, frame: FrameFeatures, keyframe: FrameFeatures) -> tuple[Correspondences, ProcrustesFit | None]:
        """The best matches, and T_kc by them alone. Where few matches are consistent, more pixels are searched."""
        pairs = lifted(self._match(frame, keyframe, self.config), frame, keyframe)
        pose = estimate_pose(pairs, self.config, self.generator)
        if self.config.query_stride == 1 or (pose is not None and int(pose.inliers.sum()) > _FEW * len(pairs)):
            return pairs, pose
        more = denser(self.config)
        more_pairs = lifted(self._match(frame, keyframe, more), frame, keyframe)
        better = estimate_pose(more_pairs, more, self.generator)
        return (pairs, pose) if better is None else (more_pairs, better)

    def is_consistent(self, pose: ProcrustesFit, pairs: Correspondences, frame: FrameFeatures, keyframe: FrameFeatures) -> bool:
        """Whether a pose is consistent with the matches and with the depth images, or with many patches of the image.

        Patches alone convince where depth was taken at another time than the image, or where few of the features match.
        """
        least = self.config.min_agreement
        if least == 0:
            return is_valid(pose, pairs, self.config)
        agreement = overlapping_pixels(pose.T_ab, keyframe, frame).depth_consistency
        if _convincing(pose, agreement):
            return True
        accidental = len(pairs) > self.config.matches and _patches(pose) < _CONFIRMING
        return is_valid(pose, pairs, self.config) and agreement >= least and not accidental

    def learns(self, keyframes: int) -> bool:
        """Whether this many stored keyframes are enough to finetune the tracker on: N_kf."""
        return keyframes >= max(2, self.finetuning.keyframes)

    @property
    def due(self) -> bool:
        """Whether there were `every` registrations since the last step of finetuning."""
        return self._registrations >= self.finetuning.every

    def finetune(self, keyframes: Sequence[FrameFeatures], T_wk: NDArray[np.float64], render: Render) -> dict[str, float] | None:
        """One step on Eq. 6 for a random pair of consecutive keyframes with poses (N, 4, 4); returns its losses by name.

        Returns None if there are fewer than N_kf keyframes, or if the pair has too few matches. Raises DivergedError
        for a loss that is not finite.
        """
        config = self.finetuning
        if not self.learns(len(keyframes)):
            return None
        self._registrations = 0
        i = int(torch.randint(len(keyframes) - 1, (), generator=self.generator))
        reference, current = keyframes[i], keyframes[i + 1]
        matches = self._match(current, reference, self.config)
        pose = estimate_pose(lifted(matches, current, reference), self.config, self.generator)
        if pose is None:
            return None
        T_wr = torch.as_tensor(T_wk[i], device=self.device)
        losses = finetuning_losses(
            current, reference, matches, pose.T_ab, T_wr, render=render, pixels=config.pixels, generator=self.generator
        )
        numbers = finetune_step(self.optimiser, losses, config)
        self._steps += 1
        if config.validate_every and self._steps % config.validate_every == 0:
            self._validate(keyframes, torch.as_tensor(T_wk))
        return numbers

    def _validate(self, keyframes: Sequence[FrameFeatures], T_wk: Tensor) -> None:
        """Validates the weights on pairs of keyframes that are never trained on; a worse result rolls them back."""
        indices = validation_pairs(keyframes, T_wk, self.finetuning.validation_pairs, self.generator)
        pairs = [(keyframes[j], keyframes[i], se3.inverse(T_wk[i]) @ T_wk[j]) for i, j in indices]
        if pairs:
            self.validator.validate(lambda: sum(self.right_matches(*pair) for pair in pairs))

    @torch.no_grad()
    def right_matches(self, frame: FrameFeatures, keyframe: FrameFeatures, T_kc: Tensor) -> int:
        """The number of mutual matches that are inliers of a pose T_kc (4, 4) that is taken as right."""
        features = self._features(frame), self._features(keyframe)
        matches = match(*features, frame.valid, keyframe.valid, query_stride=_QUERY_STRIDE, target_stride=_TARGET_STRIDE, mutual=True)
        pairs = lifted(matches, frame, keyframe)
        return int(supported(T_kc.to(self.device), pairs.frame, pairs.keyframe, self.config.inlier_distance).inliers.sum())

    def _match(self, frame: FrameFeatures, keyframe: FrameFeatures, config: TrackerConfig) -> PixelMatches:
        strides = {"query_stride": config.query_stride, "target_stride": config.target_stride}
        matches = match(self._features(frame), self._features(keyframe), frame.valid, keyframe.valid, mutual=config.mutual, **strides)
        return bucket(matches, (frame.camera.height, frame.camera.width), limit=config.matches, grid=config.grid)

    def _features(self, frame: FrameFeatures) -> Features:
        """The lookup of a frame's features, computed by the present out-conv for the requested pixels alone."""
        trunk = frame.trunk.flatten(1).mT
        return lambda pixels: self.extractor.head_at(trunk[pixels].float())


def _patches(pose: ProcrustesFit) -> int:
    """The number of patches that confirm a pose."""
    return pose.patches.inliers(pose.T_ab.cpu()) if isinstance(pose, RefinedRegistration) else 0


def _convincing(pose: ProcrustesFit, agreement: float) -> bool:
    """Whether patches alone convince. agreement: share of the overlapping depth pixels that agree."""
    return _patches(pose) >= _CONVINCING + _CONTRADICTED * (1 - agreement)


def _result(pose: ProcrustesFit, matches: int, consistent: bool) -> TrackingResult:
    covariance, aligned = (pose.covariance.numpy(), pose.patches) if isinstance(pose, RefinedRegistration) else (None, None)
    status = Status.OK if consistent else Status.LOST
    T_kc = pose.T_ab.cpu().numpy()
    return TrackingResult(T_kc, status, matches, int(pose.inliers.sum()), pose.rmse, covariance, _patches(pose), aligned)


def denser(config: TrackerConfig) -> TrackerConfig:
    """The values of a second search: `_DENSER` times the queries, the matches and the subsets' seeds, in subsets of the same size."""
    stride = max(1, round(config.query_stride / _DENSER**0.5))
    return replace(config, query_stride=stride, matches=_DENSER * config.matches, subset_share=config.subset_share / _DENSER)


def lifted(matches: PixelMatches, frame: FrameFeatures, keyframe: FrameFeatures) -> Correspondences:
    """Matches of pixels as correspondences of points; differentiable in the weights."""
    points_c, points_k = frame.points.flatten(0, 1)[matches.frame], keyframe.points.flatten(0, 1)[matches.keyframe]
    return Correspondences(frame.source.project(points_c)[0], keyframe.source.project(points_k)[0], points_c, points_k, matches.weight)
