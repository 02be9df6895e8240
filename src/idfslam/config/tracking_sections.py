"""The values of tracking: alignment to the map, and the neural tracker with its training.

What `UserOption` marks, and what the sources mean, is said in config.py.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from idfslam.config.fields import AtLeast, Count, Positive, UserOption


@dataclass(frozen=True)
class AlignmentConfig:
    """Gauss-Newton alignment of every frame to the map and to keyframe images (not in the paper); for the front end `alignment`."""

    points: Count = 3000
    """Depth points of a frame that are aligned to the map. More points cost proportionally more time."""
    iterations: Count = 12
    """Largest number of Gauss-Newton steps."""
    depth_noise: float = 0.0015
    """Standard deviation of a depth reading at the sensor's best range [m]. Larger values give the images more weight against depth. With
    0.001 and 0.0022, redkitchen has 3.57 and 3.53 cm, no better than with 0.0015 (docs/diary.md)."""
    colour_noise: float = 0.01
    """Least standard deviation of brightness, which lies in [0, 1]. The noise of a frame is measured, and used where it is larger."""
    robust: float = 0.01
    """Scale of the robust weights of depth residuals at the sensor's best range [m]; it grows with the noise of depth. Larger values let
    outliers count more."""
    robust_widest: float = 4.0
    """Largest factor by which noise widens the scale `robust`."""
    colour_robust: float = 3.0
    """Scale of the robust weights of brightness residuals, in standard deviations of brightness."""
    landmarks: int = 3600
    """Largest number of pixels of a keyframe whose brightness is compared. More of them cost proportionally more time."""
    min_landmarks: int = 100
    """A keyframe with fewer landmarks in view is not used: a few landmarks on one edge fit in many wrong places."""
    image_height: int = 480
    """Rows of the finest image whose brightness is compared. With 120, 240 and 480 rows the pose noise was 0.33, 0.13 and 0.03 cm
    (docs/diary.md)."""
    image_levels: Count = 4
    """Levels of the image pyramid, each half the size of the one before. The alignment begins on the coarsest. More levels tolerate worse
    initial poses."""
    level_reach: Positive = 1.5
    """Error of the initial pose [px] that one level of the pyramid can correct. Where recent predictions were more exact, the alignment
    begins on a finer level, which halves its steps in a slow walk (docs/findings.md)."""
    steps_a_level: Count = 2
    """Steps on each level except the finest, which takes all others."""
    references: int = 2
    """Keyframes whose images a frame is compared with: the last one, and the earliest that shares most of the view. 0: depth alone."""
    prior_information: float = 8e-3
    """Information per unit weight of depth below which a direction stays at the initial pose, because nothing measures it: a bare wall
    leaves three directions open. Larger values trust the predicted motion more (solution remapping, docs/findings.md)."""
    registration_prior_information: float = 0.1
    """The same for a new keyframe that the tracker has registered with the last one: directions with less information stay at the
    registered pose. With 0, keyframes are not registered; bookstore then had 3.45 cm instead of 1.28 (docs/findings.md)."""
    converged: float = 3e-4
    """Gauss-Newton ends when a step is shorter than this [m, rad]. Smaller values take more steps."""
    min_points: int = 100
    """Frames with fewer depth points are aligned to keyframe images alone. They are lost if these do not confirm the pose."""
    min_overlap: float = 0.3
    """Alignments are lost if a smaller share of the points falls where the map has a surface."""
    max_rmse: float = 0.02
    """Alignments with a larger RMS distance to the map [m] are lost, unless the sensor's noise alone explains it: far readings err by more.
    Space that was never mapped can seem mapped where entries of a hash table are shared."""
    doubtful_overlap: float = 0.6
    """Alignments with a smaller overlap are doubted: the tracker's pose and the last pose are tried as well."""
    doubtful_brightness: float = 1.5
    """A frame is not mapped if brightness differs more than this many times as much as in recent frames. Nor are two images taken to show
    one place then: for loops, lost cameras that are found again, and keyframes that are registered."""
    min_eigenvalue: float = 1e-3
    """Least eigenvalue of the information matrix of depth, per unit weight. Frames below it are marked as degenerate."""


@dataclass(frozen=True)
class InverseRenderingConfig:
    """Tracking of every frame by inverse rendering: Adam on its pose against the frozen map; for `front_end: inverse_rendering`."""

    pixels: Count = 200
    """Pixels of a step (iMAP, Sec. 3.5; NICE-SLAM, Sec. 4)."""
    iterations: Count = 10
    """Steps a frame (NICE-SLAM, Sec. 4: 10; iMAP: 6, from its Table 4)."""
    learning_rate: Positive = 0.001
    """Learning rate of Adam for the pose (NICE-SLAM's code)."""
    photometric_weight: float = 0.5
    """Weight of the colour loss (NICE-SLAM, Sec. 4: 0.5; iMAP, Sec. 4.1: 5)."""
    outliers: float = 10.0
    """Pixels whose error of depth over its deviation is more than this many times the median are left out (NICE-SLAM's code). 0: none."""
    border: int = 100
    """Pixels along each border of the image that are not used, but at most a quarter of its shorter side. What comes into view there is not
    in the map yet, and draws the pose back (NICE-SLAM's code: 100 for Replica, 20 for others)."""


@dataclass(frozen=True)
class TrackerConfig:
    """The neural tracker: features, matches and registration of a frame with a keyframe (Sec. V)."""

    height: Count = 120
    """Rows of the image that features are computed on; its width follows from the camera. More rows cost proportionally more time."""
    matches: Count = 200
    """K: correspondences that are kept, those with the best ratio weights (Sec. VI-A)."""
    grid: Count = 4
    """The image is divided into grid x grid cells, and a cell contributes at most K / grid^2 correspondences (Sec. V: 4). 1: no limit."""
    query_stride: Count = 6
    """Use every N-th row and column of the frame for matching. 1 (all pixels) is the paper's; larger values are faster. With 4, a pair
    takes a third more time and is no more exact (docs/model-card.md)."""
    target_stride: Count = 2
    """Use every N-th row and column of the keyframe for matching. 1 (all pixels) is the paper's; larger values are faster."""
    mutual: bool = True
    """Keep a match only if each pixel is the other's nearest neighbour. When off, the matches of both directions are used together, as
    in the paper."""
    consensus: Literal["random", "spatial_consistency"] = "spatial_consistency"
    """Subsets of correspondences that the robust Procrustes fits. `random` draws them, as the paper does. `spatial_consistency` takes
    matches that keep each other's distances (SC2-PCR); it costs the same (3 ms) and is at least as exact (docs/model-card.md)."""
    subsets: Count = 100
    """Subsets that the robust Procrustes fits."""
    subset_share: float = 0.05
    """Share of the correspondences in each subset, in (0, 1]."""
    truncation: float = 0.1
    """Largest residual of a correspondence [m] in the comparison of subsets; larger ones count as this much, so that outliers do not
    decide. 0: no limit, as in the paper."""
    refits: int = 3
    """Rounds of Procrustes on the inliers, after the best subset is chosen. The paper has none (0)."""
    inlier_distance: Positive = 0.05
    """Distance between the points of a correspondence after registration [m] below which it is an inlier."""
    plane_steps: int = 5
    """Gauss-Newton steps of point-to-plane ICP on the two depth images after the registration, with the inliers as a prior. They make
    the pose several times as exact for 8 ms (docs/model-card.md); the paper has none (0)."""
    patches: bool = True
    """Refine the matches to a fraction of a pixel: patches of the keyframe are aligned to the frame's image, and the pose is that of image
    and depth together (docs/model-card.md). When off, as in the paper, matches have the resolution of the features."""
    min_inliers: int = 12
    """Registrations with fewer inliers are lost."""
    min_inlier_share: float = 0.05
    """Registrations with a smaller share of inliers among the correspondences are lost."""
    min_agreement: float = 0.93
    """Registrations at which a smaller share of the overlapping depth pixels agree are lost. At 0.93 none of 450 pairs was accepted wrongly
    and 24 right ones were refused (docs/model-card.md). 0: depth is not tested, as in the paper."""
    min_extent: float = 0.05
    """Registrations whose inliers spread less than this [m] across their main direction are lost, because the rotation about that
    direction is not determined."""
    precision: Literal["auto", "fp32", "bf16"] = "auto"
    """Arithmetic of the feature extractor. `auto` takes bf16 where the hardware is faster with it (AVX512-BF16: 57 instead of 136 ms a
    frame, docs/performance.md)."""
    weights: UserOption[Path | None] = None
    """File of feature extractor weights from `idf-slam pretrain`. Default: those shipped with the package."""


@dataclass(frozen=True)
class FinetuneConfig:
    """Online finetuning of the feature extractor's last convolution (Sec. V-B, Eqs. 6-8)."""

    enabled: UserOption[bool] = True
    """Finetune the tracker during the run, on frames that neither become keyframes nor update the map."""
    every: int = 20
    """Registrations between two steps of finetuning; the paper takes a step after each (1). Frames that the tracker does not register do
    not count. A step takes about 50 ms (docs/performance.md)."""
    keyframes: int = 10
    """N_kf: keyframes that must be stored before finetuning starts (Sec. VI-A)."""
    learning_rate: float = 1e-4
    """Learning rate of Adam (Sec. VI-A)."""
    photometric_weight: float = 0.1
    """w_p: weight of the colour loss (Eq. 6)."""
    depth_weight: float = 1.0
    """w_d: weight of the depth loss (Eq. 6)."""
    correspondence_weight: float = 0.1
    """w_r: weight of the correspondence loss (Eq. 6)."""
    pixels: Count = 256
    """Pixels that a step renders for the colour and depth losses (Eqs. 1 and 7)."""
    validate_every: int = 5
    """Steps between two validations of the finetuned weights on pairs of keyframes that no step trains on; 0: never, as in the paper. A
    validation takes 75 ms (docs/model-card.md)."""
    validation_pairs: Count = 4
    """Pairs of keyframes in a validation. They are two keyframes apart; training pairs are neighbours."""
    margin: float = 0.05
    """If the weights find fewer correct matches than the best weights so far, by more than this share, the best are restored and the
    learning rate is halved."""


@dataclass(frozen=True)
class PretrainConfig:
    """Self-supervised pretraining of the feature extractor, without poses (Sec. V; UnsupervisedR&R [31])."""

    steps: UserOption[Count] = 2400
    """Optimisation steps."""
    batch: UserOption[Count] = 1
    """Pairs of frames a step, over all processes ([31]: 8). Pairs pass through the network one by one, so memory does not grow."""
    seed: UserOption[int] = 0
    """Seed of every random choice."""
    height: UserOption[Count] = 120
    """Rows that the frames are reduced to."""
    crop: UserOption[Annotated[tuple[int, int], AtLeast(1)]] = (96, 128)
    """Rows and columns of the random crop that a step trains on."""
    gap: UserOption[Count] = 40
    """Largest distance between the frames of a pair, in frames ([31]: 20). Larger gaps are harder and teach wider baselines."""
    ramp: float = 0.33
    """Share of the steps over which gap and augmentation grow to their values. 0 (full from the first step) suits trained weights."""
    learning_rate: UserOption[float] = 1e-3
    """Learning rate of Adam at the first step; it falls to zero along a half cosine ([31]: 1e-4, constant)."""
    weight_decay: float = 1e-6
    """Weight decay of Adam ([31])."""
    colour_weight: float = 0.0
    """Weight of the L1 loss of the rendered colour ([31]: 1). In short runs the losses of [31] slow the contrastive loss down
    (docs/model-card.md)."""
    depth_weight: float = 0.0
    """Weight of the L1 loss of the rendered depth ([31]: 1)."""
    correspondence_weight: float = 0.0
    """Weight of the distance between matched points ([31]: 0.1)."""
    contrastive_weight: float = 1.0
    """Weight of the contrastive loss, which [31] does not have."""
    temperature: Positive = 0.07
    """Temperature of the contrastive loss. Lower values push harder against the most similar wrong pixels."""
    queries: Count = 256
    """Pixels of each image that the contrastive loss takes as queries."""
    augmentation: UserOption[float] = 0.5
    """Strength of the random changes of exposure, colour, noise and sharpness, and of the holes in depth; 0: none."""
    matches: Count = 400
    """K: correspondences of the registration."""
    subsets: Count = 10
    """Random subsets of 20 % of the correspondences; the pose of the best one is rendered ([31])."""
    inliers: float = 0.2
    """Share of the correspondences that a pose must explain before its overlap is learnt from."""
    agreement: float = 0.85
    """Share of the overlapping depth pixels that must agree at a pose before its overlap is learnt from."""
    device: UserOption[Literal["auto", "cpu", "cuda"]] = "auto"
    """Device that the network is trained on. `auto` takes a GPU if there is one."""
    precision: Literal["auto", "fp32", "bf16"] = "auto"
    """Arithmetic of the network's matrix products. `auto` takes bf16 where the hardware is faster with it."""

    @property
    def rendered(self) -> bool:
        """Whether a loss of [31] takes part."""
        return max(self.colour_weight, self.depth_weight, self.correspondence_weight) > 0
