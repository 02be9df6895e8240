"""Every value of the system with its unit, effect and source; one section a component.

`UserOption` marks the values that `--help` shows. Sections and equations are those of the paper; a page of docs/ that is named holds the
measurement. The error of a recording is the RMS error of its trajectory (ATE) unless accuracy or surface is mentioned. For a value without
a source no measurement is kept.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from idfslam.config.fields import AtLeast, Count, Positive, UserOption


@dataclass(frozen=True)
class FieldConfig:
    """The neural map: one field that gives signed distance (T-SDF) and colour at any point."""

    encoding: Literal["positional", "grid"] = "grid"
    """Encoding of a position. `positional` uses sines and cosines, as NeRF and the paper do; `grid` uses a hashed multi-resolution feature
    grid."""
    truncation: Positive = 0.06
    """Truncation distance tr of the T-SDF [m]. Larger values tolerate more noise in depth and blur thin objects (Sec. VI-A: 0.10)."""
    position_frequencies: int = 8
    """Frequencies of the positional encoding of a position. More frequencies allow finer detail; only for the encoding `positional`."""
    direction_frequencies: int = 0
    """Frequencies of the encoding of the viewing direction. With 0, colour does not depend on the direction (paper preset: 4)."""
    layers: Count = 1
    """Hidden layers of the network's trunk (Sec. IV-A: 8). With the feature grid one layer is as accurate as two (docs/diary.md)."""
    width: Count = 32
    """Width of the trunk (Sec. IV: 256)."""
    skip: int = 0
    """Trunk layer that receives the encoded position a second time, as in NeRF; 0: none."""
    colour_width: int = 32
    """Width of the hidden layer of the colour head."""
    levels: Count = 6
    """Resolution levels of the feature grid. With eight, a frame takes 7 % more time and is tracked no better (docs/diary.md)."""
    features: Count = 2
    """Features that each level stores at a grid vertex."""
    coarsest: Positive = 0.48
    """Cell edge of the coarsest level [m]. With 0.64, redkitchen has 3.36 cm instead of 3.27 (docs/diary.md)."""
    finest: Positive = 0.04
    """Cell edge of the finest level [m]. Smaller cells resolve more detail and follow more noise: with cells of 2, 4 and 6 cm the noisy
    kitchen had an accuracy of 1.81, 1.42 and 2.18 cm (docs/diary.md)."""
    table_log2: int = 15
    """Size of each level's hash table at the start of a run, as a power of two. Tables double as the scene grows."""
    table_log2_max: int = 18
    """Largest size of a hash table, as a power of two. Beyond it, distant places share entries."""
    table_load: float = 0.8
    """Share of a level's entries in use above which the tables double, in [0, 1]."""


@dataclass(frozen=True)
class MapperConfig:
    """Optimisation of the map, and in the paper preset of the keyframes' poses (Sec. IV)."""

    supervision: Literal["rendering", "samples"] = "samples"
    """`rendering` renders rays and compares colour and depth (Eqs. 1-3). `samples` compares distance and colour at the samples themselves,
    which needs far fewer samples a ray."""
    pixels: Count = 512
    """B: pixels drawn from each image for a step (Sec. VI-A: 1024). Used where `step_pixels` is 0, and by the pose optimisation."""
    step_pixels: int = 1024
    """Pixels of a step, divided among its images, so that a step costs the same however many images there are. With 0, each image
    contributes `pixels`, as in the paper."""
    samples: Count = 6
    """Stratified samples a ray (`rendering`), or samples within the truncation distance of the surface (`samples`). 4 with 2 importance
    samples gives a sixth more frames/s; the surface of bookstore then has 0.99 cm instead of 0.91 (docs/diary.md)."""
    importance_samples: int = 3
    """Further samples around the rendered surface (`rendering`), or in the free space before it (`samples`)."""
    sharpness: Positive = 10.0
    """Sharpness s of the rendering weights sigmoid(s D/tr) sigmoid(-s D/tr), with D the signed distance. Larger values concentrate the
    weight at the surface. 10 is 1/tr of the paper preset, as in the published code of [25]; with 1, free space outweighs the surface."""
    photometric_weight: float = 2.0
    """w_p: weight of the colour loss (Eq. 3)."""
    free_space_weight: float = 0.2
    """w_fs: weight of the free-space loss (Eq. 2)."""
    truncation_weight: float = 10.0
    """w_tr: weight of the loss near the surface (Eq. 2)."""
    background: bool = True
    """Optimise the map in a thread of its own while the next frames are tracked; they are aligned to the map of the update before. When
    off, tracking waits for each map update. Two such threads on two cores ran 1.9 times as fast as one (docs/findings.md)."""
    min_mapped_share: float = 0.95
    """If the map explains less than this share of a new keyframe's depth, the map is updated before the next frame instead of in the
    background. Higher values let tracking wait more often. Without such updates the fast walk dining_fast had 1.21 cm instead of 1.04
    (docs/findings.md); no effect where `background` is off."""
    redraw: Count = 10
    """Steps between two drawings of pixels. With 1, the losses of each step decide on the pixels of the next, as in the paper; larger
    values are faster."""
    active_sampling: bool = True
    """Draw more pixels where the loss is high, by cells of the image (Sec. IV). When off, pixels are drawn uniformly."""
    light: bool = True
    """Bring each image to the exposure of the first keyframe, and take out the lens's vignetting, before the map learns its colours. Both
    are estimated from places that several keyframes see. When off, the map learns colours as they were recorded, as in the paper."""
    cells: Count = 8
    """Cells of the image along each side for active sampling (Sec. IV: 8)."""
    learning_rate: float = 0.01
    """Learning rate of Adam for the network (Sec. VI-A: 0.005)."""
    first_iterations: int = 100
    """Optimisation steps on the first frame, before the second is tracked."""
    iterations: int = 10
    """Optimisation steps of a map update. With eight, redkitchen has 3.46 cm instead of 3.27 (docs/diary.md)."""
    pose_optimisation: bool = False
    """Optimise the pose of each new keyframe by rendering it from the map (Eq. 4), as in the paper."""
    pose_iterations: int = 50
    """Steps of the pose optimisation."""
    pose_learning_rate: float = 0.005
    """Learning rate of Adam for the pose at the first step (Sec. VI-A)."""
    pose_decay: float = 0.7
    """Decay factor of the pose's learning rate, applied every `pose_decay_every` steps (Sec. VI-A)."""
    pose_decay_every: Count = 10
    """Steps between two decays of the pose's learning rate (Sec. VI-A)."""
    table_rate: float = 0.01
    """Learning rate of Adam for the feature grid."""
    free_margin: float = 0.6
    """Least T-SDF required in free space, in units of tr (`samples`). The loss is zero above it, because another surface may be
    nearer than the one that the ray meets."""
    every: int = 4
    """The map is updated again after this many frames, whether or not one of them is a keyframe. With 0, only keyframes update it, as in
    the paper. With 5, redkitchen has 3.5 cm instead of 3.27 (docs/diary.md)."""
    gradient_clip: float = 0.0
    """Largest norm of the gradient of the map's weights; a longer gradient is scaled down to it. 0: no limit."""
    warm_up: int = 0
    """Steps over which the learning rate rises from zero to its value."""
    precision: Literal["auto", "fp32", "bf16"] = "auto"
    """Arithmetic of the map's matrix products. `auto` takes bf16 where the hardware is faster with it."""


@dataclass(frozen=True)
class VolumeDensityConfig:
    """iMAP's map: one network of colour and volume density; for `map_representation: volume_density` (docs/presets.md)."""

    features: Count = 93
    """Fourier features of a position (iMAP, Sec. 4.1)."""
    deviation: Positive = 25.0
    """Standard deviation of the features' matrix [rad], for positions in `unit` (iMAP, Sec. 4.1). Larger values allow finer detail."""
    unit: Positive = 10.0
    """Length that counts as 1 in the network [m] (iMAP, Sec. 4.1: coordinates are normalised by 1/10)."""
    layers: Count = 4
    """Hidden layers (iMAP, Sec. 3.1)."""
    width: Count = 256
    """Width of the hidden layers (iMAP, Sec. 3.1)."""
    density_scale: Positive = 10.0
    """Density [1/m] of one unit of the network's output. Larger values let surfaces form in fewer steps."""
    truncation: Positive = 0.1
    """Length [m] of a ray that the density of the surface makes half opaque. Larger values put the surface of meshes nearer to the
    camera."""


@dataclass(frozen=True)
class OccupancyGridsConfig:
    """NICE-SLAM's map: feature grids of four levels, with decoders; for `map_representation: occupancy_grids` (docs/presets.md)."""

    coarse: Positive = 2.0
    """Cell edge of the coarse level [m] (NICE-SLAM, Sec. 4)."""
    middle: Positive = 0.32
    """Cell edge of the middle level [m] (NICE-SLAM, Sec. 4)."""
    fine: Positive = 0.16
    """Cell edge of the fine level [m] (NICE-SLAM, Sec. 4)."""
    colour: Positive = 0.16
    """Cell edge of the level of colours [m] (NICE-SLAM's code)."""
    features: Count = 32
    """Features at a vertex (NICE-SLAM, Sec. 4). The shipped decoders have this number."""
    width: Count = 32
    """Width of the decoders (NICE-SLAM, Sec. 4). The shipped decoders have this one."""
    blocks: Count = 5
    """Layers of the decoders (NICE-SLAM, Sec. 4). The shipped decoders have this number."""
    frequencies: Count = 93
    """Fourier features of a position in the decoders (NICE-SLAM, Sec. 4). The shipped decoders have this number."""
    deviation: Positive = 25.0
    """Standard deviation of the features' matrix [rad/m] (NICE-SLAM, Sec. 4), of the colour decoder; the others are trained."""
    middle_rate: Positive = 0.1
    """Learning rate of the middle level in the stage `middle` (NICE-SLAM's code)."""
    rate: Positive = 0.005
    """Learning rate of the middle, fine and colour levels in later stages (NICE-SLAM's code)."""
    decoder_rate: Positive = 0.005
    """Learning rate of the colour decoder (NICE-SLAM's code)."""
    coarse_rate: Positive = 0.001
    """Learning rate of the coarse level (NICE-SLAM's code)."""
    first_factor: Positive = 5.0
    """Factor on these rates at the first frame (NICE-SLAM's code)."""
    middle_share: float = 0.4
    """Share of the steps of an update that learns the middle level alone (NICE-SLAM's code)."""
    fine_share: float = 0.6
    """Share of the steps after which colours are learnt, and poses are moved; before, the fine level joins (NICE-SLAM's code)."""
    in_view: bool = True
    """Learn the features in the current view alone (NICE-SLAM, Sec. 3.3). When off, those of all keyframes of an update."""
    refinement_rounds: int = 5
    """Updates after the last frame that refine colours and features, each with twice the keyframes (NICE-SLAM's code). 0: none."""
    table_log2: Count = 15
    """Size of the hash table of the fine and colour levels at the start, as a power of two. The others have fewer entries."""
    table_log2_max: Count = 20
    """Largest size of a hash table, as a power of two. Beyond it, distant places share features."""
    table_load: float = 0.8
    """Share of a level's entries in use above which its table doubles, in [0, 1]."""
    truncation: Positive = 0.08
    """Largest step of a ray that is traced to the surface [m]. Larger values are faster and less exact."""
    weights: Path | None = None
    """File of decoder weights. Default: those shipped with the package."""


@dataclass(frozen=True)
class JointMappingConfig:
    """Joint optimisation of the map and the poses of a window of frames; for `back_end: joint_mapping` (docs/presets.md)."""

    window: Count = 5
    """Frames of a window: the current one, the last keyframe, and chosen keyframes (iMAP, Sec. 3.5: W = 5; NICE-SLAM, Sec. 4: K = 5)."""
    choice: Literal["loss", "overlap"] = "loss"
    """How keyframes are chosen. `loss`: at random, in proportion to their loss, anew for each step (iMAP). `overlap`: at random among those
    that have some of the current view in sight (NICE-SLAM)."""
    pose_learning_rate: Positive = 0.001
    """Learning rate of Adam for the poses of the window (NICE-SLAM's code; iMAP's paper has none)."""
    poses_from: int = 0
    """Poses are optimised once more keyframes than this are stored (NICE-SLAM's code: 4)."""


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
class KeyframeConfig:
    """Choice of keyframes, and of those that each map update replays (Sec. IV-C)."""

    translation: UserOption[float] = 0.15
    """Distance from the last keyframe [m] above which a frame becomes a keyframe. Smaller values keep more keyframes: better coverage,
    more memory and time."""
    rotation: float = 12.0
    """Rotation from the last keyframe [degrees] above which a frame becomes a keyframe."""
    in_view: float = 0.4
    """Add a keyframe when less than this share of the reference keyframes' landmarks is visible, before too few are left to align the next
    frames. Higher values keep more keyframes. Only for the front end `alignment`."""
    in_view_every: int = 3
    """`in_view` adds a keyframe only if the last one is more than this many frames old. Without this, every frame in front of a bare wall
    would become a keyframe."""
    least_sharpness: float = 0.75
    """A frame that is less sharp than this share of the frames before it becomes no keyframe for up to 5 frames, unless less than `in_view`
    of the landmarks is visible. Higher values put off more keyframes; 0, as in the paper, puts off none."""
    cull: float = 0.92
    """sigma_cull: a new keyframe is dropped if its covisibility with a stored one is higher. Lower values keep fewer keyframes; 1 keeps
    all (Sec. VI-A: 0.5). With 0.8 the noisy kitchen's accuracy is 1.31 cm instead of 0.84 (docs/diary.md)."""
    cull_reach: float = 0.4
    """A stored keyframe can replace a new one only within this distance of it, as a share of the new one's median depth, because from
    farther off readings are coarser and noisier. Without the limit (0, as in the paper) the noisy kitchen's accuracy is 1.42 cm instead
    of 0.84 (docs/diary.md)."""
    edge_length: float = 4.0
    """Two covisible keyframes count as measured against each other if a path of pose-graph edges of at most this length [m] joins them.
    Beyond it the overlap is tested for a loop instead. Larger values hide more drift: without a limit, two long edges around a block hid
    8 cm of it (docs/findings.md)."""
    covisible: float = 0.3
    """sigma_covis: covisibility above which two keyframes are connected (Sec. VI-A)."""
    shared: float = 0.6
    """Covisibility with the last keyframe above which an earlier keyframe serves as a second reference of the alignment."""
    in_memory: int = 64
    """Keyframes whose images and features stay in memory, about 5 MB each at 640x480. Those of the others lie in a temporary file."""
    reference: Literal["last", "covisible"] = "last"
    """Keyframe that the tracker registers a frame with: the last one, or the stored one with the highest covisibility. With `covisible`
    the tracker alone has 0.80 cm instead of 1.35 on dining_fast and hardly a difference on redkitchen (docs/results.md)."""
    choice: Literal["motion", "information_gain", "interval"] = "motion"
    """What makes a frame a keyframe. `motion`: distance and rotation from the last one. `information_gain`: too little of the frame is
    explained by the map as it was at the last keyframe (iMAP). `interval`: every `interval`-th frame (NICE-SLAM)."""
    explained: float = 0.65
    """t_P: share of the pixels below which a frame becomes a keyframe (`information_gain`; iMAP, Sec. 4.1). Larger values keep more."""
    explained_error: float = 0.1
    """t_D: largest error of a rendered depth, as a share of the reading, at which a pixel is explained (iMAP, Sec. 3.4)."""
    interval: Count = 50
    """Frames from keyframe to keyframe (`interval`; NICE-SLAM's code)."""
    replay: int = 2
    """N_rep: stored keyframes, not connected with the newest, that each map update trains on too (Sec. VI-A: 10)."""
    replay_connected: int = 2
    """Keyframes connected with the newest that each map update trains on too. The paper replays none (0)."""


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
class RefinementConfig:
    """Refinement of keyframe poses against the map, with each map update and after the last frame (not in the paper)."""

    updates: int = 20
    """Least number of map updates after the last frame. Only with `--refine`."""
    keyframes: int = 8
    """Keyframes in each of these updates, drawn at random. The map is trained on all of them, and half of them are aligned anew."""
    rounds: float = 2.0
    """How often each keyframe is aligned anew after the last frame, on average; long runs get more updates accordingly."""
    seconds: Positive = 60.0
    """Time limit of the refinement after the last frame [s]. A run that reaches it is not repeatable bit by bit."""
    poses_per_update: int = 1
    """Replayed keyframes that are aligned anew with each map update during the run. Each costs one short alignment (docs/findings.md)."""
    max_shift: float = 0.02
    """A keyframe that would move farther than this [m] in one refinement keeps its pose: so large a step is a wrong alignment."""
    adjust_local: bool = True
    """With each new keyframe, the newest ones are adjusted together with the landmarks that they share, where the images agree."""
    adjust: bool = True
    """After the last frame, all keyframes are adjusted together with the landmarks that they share, where the images agree well enough."""


@dataclass(frozen=True)
class LoopConfig:
    """Loop closure, relocalisation and submaps (not in the paper, which names their lack as its limit); for the front end `alignment`."""

    enabled: UserOption[bool] = True
    """Detect places seen before and correct the drift of all poses by a pose graph."""
    relocalise: bool = True
    """Search for a lost camera among all keyframes. When off, lost frames are mapped at the predicted pose, as in the paper."""
    tries: int = 3
    """Stored keyframes that a new keyframe is registered with in search of a loop. More tries find more loops and cost more time."""
    relocalisation_tries: int = 4
    """Stored keyframes that a lost frame is registered with, or a keyframe of another submap. The five most similar
    ones contain an overlapping one in 82 to 84 % of cases (docs/findings.md)."""
    submap_after: int = 30
    """Frames with depth for which a lost camera is searched for before a new submap is started; 0: no submap is ever started."""
    merge_confirmations: int = 3
    """Consecutive keyframes that must agree on the relative pose of two submaps before these are merged. Higher values reject more places
    that merely look alike."""
    merge_span: float = 0.3
    """Distance between the first and the last of these keyframes [m], at least. A rotation counts by the motion of a point 2 m ahead.
    Places that look alike do so over short distances."""
    slack: float = 0.15
    """Largest correction of a loop [m], apart from `drift`. Larger corrections are taken for places that look alike."""
    drift: float = 0.03
    """Further correction allowed for each metre of path around the loop [m/m]."""
    turn_slack: float = 3.0
    """Largest correction of a loop's rotation [degrees], apart from `turn_drift`."""
    turn_drift: float = 0.3
    """Further correction of the rotation allowed for each metre of path around the loop [degrees/m]."""
    confirmed_within: float = 1.0
    """A loop is closed only when a second one, at most this far away [m], requires the same correction."""
    relearn_updates: int = 6
    """Map updates that replay each keyframe that a loop or a merge has moved, so that the map follows its new pose."""


@dataclass(frozen=True)
class FusionConfig:
    """The volume of fused depth images that sharpens the map's surface at the end of a run."""

    enabled: bool = True
    """Fuse the depth images of mapped views at their final poses. Meshes and views of the map are sharper, and its file is larger."""
    voxel: Positive = 0.015
    """Edge of a voxel [m]. Larger ones are faster and smaller, and smooth more."""
    blocks: Count = 40_000
    """Largest number of blocks of 8 x 8 x 8 voxels. In scenes that need more, voxels are larger."""


@dataclass(frozen=True)
class MeshConfig:
    """Extraction of the mesh from the map."""

    resolution: UserOption[Positive] = 0.02
    """Cell edge of marching cubes [m]. Half the value gives about four times the triangles."""


@dataclass(frozen=True)
class Config:
    """All values of a run."""

    preset: UserOption[Literal["fast", "paper", "imap", "nice"]] = "fast"
    """Set of values to start from: `fast` for use, `paper` for the values of the paper (Sec. VI-A), `imap` and `nice` for those of iMAP and
    NICE-SLAM, in our implementations (docs/presets.md). Other options change single values."""
    seed: UserOption[int] = 0
    """Seed of every random choice."""
    device: UserOption[Literal["auto", "cpu", "cuda"]] = "auto"
    """Device that the networks run on. `auto` takes the CPU for the preset `fast`, which was never run on a GPU,
    and a GPU if there is one for `paper`."""
    front_end: str = "alignment"
    """The part that tracks frames. `alignment` aligns every frame to the map and uses the neural tracker where the result is in doubt.
    `registration` uses the neural tracker alone, as in the paper. `inverse_rendering` moves the pose until the rendered map shows the
    frame, as iMAP and NICE-SLAM do."""
    map_representation: str = "neural_field"
    """The part that is the map. `neural_field` is one network of T-SDF and colour, as in the paper. `volume_density` is iMAP's map, and
    `occupancy_grids` NICE-SLAM's."""
    back_end: str = "keyframe_mapping"
    """The part that maps. `keyframe_mapping` trains the map on each keyframe and on replayed ones, as in the paper. `joint_mapping`
    optimises the map and the poses of a window together, as iMAP and NICE-SLAM do."""
    refine: UserOption[bool] = True
    """Refine all keyframe poses and the map together after the last frame."""
    calibrate: UserOption[Literal["off", "warn", "on"]] = "warn"
    """Whether the camera is checked. `warn` says so where the views show that it is not as stated. `on` first calibrates it from the whole
    recording (`idf-slam calibrate`), and then runs with what was found, which takes twice as long."""
    archive: UserOption[bool] = True
    """Keep images of the recording beside the map (archive.safetensors), which views, videos and the colours of meshes are made of."""
    archive_megabytes: Positive = 20.0
    """Size of that archive [MB] at most. A room takes 20; in larger scenes more is sharper away from the few images that are left."""
    hold_out: int = 0
    """Keep every N-th frame from the map, the keyframes and the archive of images, so that `idf-slam eval --views` can compare it with the
    rendered view; it is tracked like any other. 0: none."""
    movers: UserOption[Literal["mask", "off"]] = "mask"
    """What moves before the camera (people, doors, things that are carried). `mask` finds it by the free space that earlier views saw, and
    leaves it out of tracking and of the map. `off` takes everything for static."""
    field: FieldConfig = FieldConfig()
    mapper: MapperConfig = MapperConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    tracker: TrackerConfig = TrackerConfig()
    finetune: FinetuneConfig = FinetuneConfig()
    alignment: AlignmentConfig = AlignmentConfig()
    refinement: RefinementConfig = RefinementConfig()
    loops: LoopConfig = LoopConfig()
    fusion: FusionConfig = FusionConfig()
    mesh: MeshConfig = MeshConfig()
    volume_density: VolumeDensityConfig = VolumeDensityConfig()
    occupancy_grids: OccupancyGridsConfig = OccupancyGridsConfig()
    joint_mapping: JointMappingConfig = JointMappingConfig()
    inverse_rendering: InverseRenderingConfig = InverseRenderingConfig()
