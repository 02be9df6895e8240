"""Every value of the system with its unit and meaning, one section a component."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class FieldConfig:
    """The implicit map: one network of T-SDF and colour."""

    encoding: Literal["positional", "grid"] = "grid"
    """How a position [m] becomes features: NeRF's frequencies, or a multi-resolution feature grid."""
    truncation: float = 0.06
    """Truncation distance tr [m] (Sec. VI-A)."""
    position_frequencies: int = 8
    """Frequencies of the positional encoding of a position."""
    direction_frequencies: int = 0
    """Frequencies of the positional encoding of a view direction; 0: colour does not depend on it."""
    layers: int = 1
    """Hidden layers of the trunk (Sec. IV: 8)."""
    width: int = 32
    """Width of the trunk (Sec. IV: 256)."""
    skip: int = 0
    """The layer at which the encoded position is fed in again; 0: nowhere."""
    colour_width: int = 32
    """Width of the colour head's hidden layer."""
    levels: int = 6
    """Levels of the feature grid."""
    features: int = 2
    """Features a level of the grid."""
    coarsest: float = 0.48
    """Edge of the coarsest level's cells [m]."""
    finest: float = 0.04
    """Edge of the finest level's cells [m]."""
    table_log2: int = 15
    """Entries of a level's table at the start, as a power of two; tables double as the scene grows."""
    table_log2_max: int = 18
    """Up to here a table doubles; past it entries are shared."""
    table_load: float = 0.8
    """Share of a level's entries in use beyond which it does."""


@dataclass(frozen=True)
class MapperConfig:
    """How the map and the keyframe poses are optimised (Sec. IV)."""

    supervision: Literal["rendering", "samples"] = "samples"
    """Volume rendering (Eqs. 1-3), or T-SDF and colour of the samples themselves."""
    pixels: int = 512
    """B: pixels an image and step (Sec. VI-A: 1024)."""
    step_pixels: int = 1024
    """Pixels of a step over all its keyframes, so that steps cost the same however many they are; 0: B of each, as in the paper."""
    samples: int = 6
    """Stratified samples a ray."""
    importance_samples: int = 3
    """Further samples around the rendered surface."""
    sharpness: float = 10.0
    """Sharpness of the rendering weights sigmoid(s D/tr) sigmoid(-s D/tr)."""
    squared: bool = True
    """Squared residuals in Eqs. 1 and 2, as in the loss that the paper refers to; off: the printed norms (rendering supervision)."""
    photometric_weight: float = 2.0
    """w_p of Eq. 3."""
    free_space_weight: float = 0.2
    """w_fs of Eq. 2."""
    truncation_weight: float = 10.0
    """w_tr of Eq. 2."""
    beside: bool = True
    """Learn beside the frames that follow, on a core of its own; they are aligned to the map of the update before. Off: in turns."""
    known: float = 0.95
    """A keyframe of whose depth the map knows a smaller share is learnt before the next frame all the same, and one soon after the last."""
    redraw: int = 10
    """Steps for which pixels are drawn at once; 1: the losses of each step decide on the pixels of the next, as in the paper."""
    active_sampling: bool = True
    """Choose pixels by the loss of their 8 x 8 image cell."""
    cells: int = 8
    """Cells a side for active sampling."""
    learning_rate: float = 0.01
    """Adam's rate for the map."""
    first_iterations: int = 100
    """Steps on the first frame."""
    iterations: int = 10
    """Steps a map update."""
    pose_optimisation: bool = False
    """Refine the poses of keyframes against the map (Eq. 4)."""
    pose_iterations: int = 50
    """Steps of the pose optimisation."""
    pose_learning_rate: float = 0.005
    """Adam's first rate for the pose."""
    pose_decay: float = 0.7
    """The pose's rate is multiplied by this ..."""
    pose_decay_every: int = 10
    """... every so many steps."""
    table_rate: float = 0.01
    """Adam's rate for the feature grid."""
    free_margin: float = 0.6
    """In free space the T-SDF, in units of tr, should be no less (samples supervision)."""
    final_updates: int = 20
    """Map updates after the last frame, at least (--refine) ..."""
    final_keyframes: int = 8
    """... on so many keyframes each, half of which are aligned anew; ..."""
    final_rounds: float = 2.0
    """... as many of them as it takes to align each keyframe so often, ..."""
    final_seconds: float = 60.0
    """... and not for longer than this [s]."""
    certainty: float = 0.0
    """Power of a reading's relative certainty by which it counts (samples supervision); 0: all alike."""
    every: int = 4
    """A map update on every so many frames, keyframe or not; 0: on keyframes alone, as in the paper."""
    gradient_clip: float = 0.0
    """Largest norm of the map's gradient; 0: not clipped."""
    warm_up: int = 0
    """Steps over which the learning rate rises to its value."""
    precision: Literal["auto", "fp32", "bf16"] = "auto"
    """Arithmetic of the matrix products; auto: bf16 where the machine is good at it."""


@dataclass(frozen=True)
class KeyframeConfig:
    """When a frame is kept, and which of the kept ones are replayed (Sec. IV-C)."""

    translation: float = 0.15
    """Motion since the last keyframe [m] that asks for a new one."""
    rotation: float = 12.0
    """Rotation since the last keyframe [degrees] that asks for a new one."""
    in_view: float = 0.4
    """Smaller share of the reference keyframes' landmarks in view: a new one is asked for too (alignment to the map) ..."""
    in_view_every: int = 3
    """... unless the last is no more than so many frames old: on a bare wall a new one helps no better."""
    culling: bool = True
    """Drop a new keyframe that a stored one covers."""
    cull: float = 0.92
    """sigma_cull: covisibility above which a new keyframe is dropped ..."""
    cull_reach: float = 0.4
    """... unless it stands farther from the other than this share of its median depth, from where it shows more; 0: always (paper)."""
    linked_within: float = 4.0
    """Way [m] over links up to which covisible keyframes count as measured against each other."""
    covisible: float = 0.3
    """sigma_covis: covisibility above which two keyframes are connected."""
    shared: float = 0.6
    """Covisibility above which an earlier keyframe serves as a second reference for alignment."""
    in_memory: int = 64
    """Keyframes whose images and features are held in memory; those of the others lie in a temporary file."""
    occlusion: bool = False
    """Count a pixel as covisible only if the other keyframe's depth agrees (Eq. 5 tests bounds alone)."""
    reference: Literal["last", "covisible"] = "last"
    """The keyframe that the tracker registers a frame against: the last chosen, or the stored one that has most of it in view."""
    replay: int = 2
    """N_rep: stored keyframes, not connected to the newest, that each step trains on too."""
    replay_connected: int = 2
    """Keyframes connected to the newest that each step trains on too (not in the paper: 0)."""


@dataclass(frozen=True)
class TrackerConfig:
    """The neural tracker (Sec. V)."""

    height: int = 120
    """Rows of the images that features are computed on; the width follows the camera."""
    matches: int = 200
    """K: correspondences kept, the best by ratio weight."""
    grid: int = 4
    """At most K / grid^2 correspondences from a cell of a grid x grid image; 1: no limit."""
    query_stride: int = 4
    """Every so many rows and columns a pixel asks for its nearest neighbours; 1: all of them."""
    target_stride: int = 2
    """Every so many rows and columns a pixel may be the answer; 1: all of them."""
    mutual: bool = True
    """Keep a match only if its answer, asked back, returns; off: the matches of both directions together, as in the paper."""
    consensus: Literal["random", "compatible"] = "compatible"
    """Which subsets the robust Procrustes tries: random ones, as in the paper, or matches that keep each other's distances (SC2-PCR)."""
    subsets: int = 100
    """Subsets tried by the robust Procrustes."""
    subset_share: float = 0.05
    """Share of the correspondences in a subset."""
    truncation: float = 0.1
    """A correspondence's residual counts no more than this [m] in choosing the best subset; 0: no such limit."""
    refits: int = 3
    """Rounds of Procrustes on all inliers after the best subset."""
    inlier_distance: float = 0.05
    """A correspondence this close [m] after alignment is an inlier."""
    plane_steps: int = 5
    """Gauss-Newton steps that then bring the depth images together, point to plane, held by the inliers; 0: none, as in the paper."""
    min_inliers: int = 12
    """Fewer inliers: lost."""
    min_inlier_share: float = 0.05
    """Smaller share of inliers among the correspondences: lost."""
    min_agreement: float = 0.93
    """Smaller share of the overlapping depth pixels that agree at the pose: lost; 0: depth is not asked."""
    min_extent: float = 0.05
    """Inliers that spread less than this [m] across their main direction: lost."""
    precision: Literal["auto", "fp32", "bf16"] = "auto"
    """Arithmetic of the feature extractor; auto: bf16 where the machine is good at it."""
    weights: Path | None = None
    """Weights of the feature extractor; none given: those shipped with the package."""


@dataclass(frozen=True)
class FinetuneConfig:
    """Online finetuning of the tracker's out-conv (Sec. V-B, Eqs. 6-8)."""

    enabled: bool = True
    """Finetune on frames that are neither keyframes nor learnt by the map."""
    every: int = 20
    """One step after every so many registrations (the paper: after each); where the tracker is not asked, it need not learn."""
    keyframes: int = 10
    """N_kf: keyframes that must be stored before it starts."""
    learning_rate: float = 1e-4
    """Adam's rate."""
    photometric_weight: float = 0.1
    """w_p of Eq. 6."""
    depth_weight: float = 1.0
    """w_d of Eq. 6."""
    correspondence_weight: float = 0.1
    """w_r of Eq. 6."""
    pixels: int = 256
    """Pixels rendered for Eqs. 1 and 7."""
    guard: int = 5
    """Every so many steps the weights are tried on held-out pairs of keyframes; 0: never, as in the paper."""
    held_out: int = 4
    """Pairs of keyframes of such a trial: neighbours but one, which are never trained on."""
    margin: float = 0.05
    """A share of right matches lost there beyond which the steps since the best weights are undone."""


@dataclass(frozen=True)
class PretrainConfig:
    """How the feature extractor is pretrained, without poses (Sec. V; UnsupervisedR&R [31])."""

    steps: int = 2400
    """Steps of the optimiser."""
    batch: int = 1
    """Pairs a step, over all processes ([31]: 8); each goes through the network by itself, so memory does not grow with them."""
    seed: int = 0
    """Seed of every random choice."""
    height: int = 120
    """Rows that the frames are reduced to."""
    crop: tuple[int, int] = (96, 128)
    """Rows and columns of the random crop that a step trains on."""
    gap: int = 40
    """Frames of a pair lie at most this far apart ([31]: 20)."""
    ramp: float = 0.33
    """Share of the steps over which distance and augmentation grow to their values; 0: at once, for weights that know something."""
    learning_rate: float = 1e-3
    """Adam's first rate, falling to zero along a half cosine ([31]: 1e-4, constant)."""
    weight_decay: float = 1e-6
    """Adam's weight decay [31]."""
    colour_weight: float = 0.0
    """Weight of the rendered colour's L1 ([31]: 1). In short runs the losses of [31] hold the contrastive one back (docs/model-card.md)."""
    depth_weight: float = 0.0
    """Weight of the rendered depth's L1 ([31]: 1)."""
    correspondence_weight: float = 0.0
    """Weight of the matched points' distance ([31]: 0.1)."""
    contrastive_weight: float = 1.0
    """Weight of the contrastive loss (not in [31])."""
    temperature: float = 0.07
    """Of the contrastive loss."""
    queries: int = 256
    """Pixels of each image that ask for their partner in the contrastive loss."""
    augmentation: float = 0.5
    """Strength of the changes of exposure, colour, noise, sharpness and of the holes in depth; 0: none."""
    matches: int = 400
    """K of the registration."""
    subsets: int = 10
    """Random subsets of 20 % that the rendered pose is the best of [31]."""
    inliers: float = 0.2
    """Share of the matches that a pose must explain before its correspondences are learnt."""
    agreement: float = 0.85
    """Share of overlapping depth pixels that it must explain too."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where the network learns; auto: a GPU when there is one."""
    precision: Literal["auto", "fp32", "bf16"] = "auto"
    """Arithmetic of the network's matrix products; auto: bf16 where the machine is good at it."""

    @property
    def rendered(self) -> bool:
        """Whether a loss of [31] takes part."""
        return max(self.colour_weight, self.depth_weight, self.correspondence_weight) > 0


@dataclass(frozen=True)
class AlignmentConfig:
    """Second-order alignment of every frame to the map (not in the paper)."""

    points: int = 3000
    """Depth points of a frame that are aligned."""
    iterations: int = 12
    """Largest number of Gauss-Newton steps."""
    depth_noise: float = 0.0015
    """Noise of a depth reading at the sensor's best [m]; the images count against depth by it."""
    colour_noise: float = 0.01
    """Least noise of brightness, in [0, 1]; a frame's own, when larger, is measured."""
    robust: float = 0.01
    """Scale of the robust weights at the sensor's best [m]; it widens with the noise of depth ..."""
    robust_widest: float = 4.0
    """... up to so many times."""
    colour_robust: float = 3.0
    """Scale of the robust weights of brightness, in units of its noise."""
    landmarks: int = 3600
    """Pixels of a keyframe whose brightness is compared, at most."""
    min_landmarks: int = 100
    """With fewer of a keyframe's landmarks in view its image says nothing: a handful on one edge fits in many wrong places."""
    image_height: int = 480
    """Rows of the finest image that brightness is compared in."""
    image_levels: int = 4
    """Images that brightness is compared in, each half the size of the one before; the coarsest comes first."""
    level_reach: float = 1.5
    """How far off a guess may be on an image [px of that image]; what is known to be nearer begins on a finer one."""
    steps_a_level: int = 2
    """Steps on each but the finest, which has the rest."""
    references: int = 2
    """Keyframes whose images a frame is held against: the last, and the earliest that sees most of the same; 0: depth alone."""
    hold: float = 8e-3
    """Information, per unit weight of depth, below which a direction is held to the guess (a bare wall leaves three open)."""
    hold_registered: float = 0.1
    """The same for a keyframe that the neural tracker has registered with the last one: held to that; 0: it is not asked."""
    converged: float = 3e-4
    """Steps below this [m, rad] end the iteration."""
    refined: int = 1
    """Replayed keyframes whose pose is aligned anew at each map update, in turns with the map: bundle adjustment."""
    refine_reach: float = 0.02
    """A keyframe that would move farther than this [m] at once stays where it is: that is no refinement."""
    min_points: int = 100
    """Fewer points with depth: lost."""
    min_overlap: float = 0.3
    """Smaller share of points that fall where the map is known: lost."""
    max_rmse: float = 0.02
    """Wider distances to the map [m]: lost; unmapped space can seem mapped where entries of a table are shared."""
    doubtful_overlap: float = 0.6
    """Smaller overlap: the neural tracker is asked for a second guess."""
    doubtful_brightness: float = 1.5
    """Colours that fit so many times worse than lately: the same."""
    min_stiffness: float = 1e-3
    """Less information of depth in some direction, per point: degenerate."""


@dataclass(frozen=True)
class LoopConfig:
    """Loops closed and lost cameras found again (not in the paper, whose stated limits these are)."""

    enabled: bool = True
    """Look for places seen before, and correct all poses where one shows drift (alignment to the map)."""
    relocalise: bool = True
    """Look for a lost camera among all keyframes; off: frames are mapped where the last motion leads, as in the paper."""
    tries: int = 3
    """Keyframes that a new keyframe is compared with in search of a loop ..."""
    relocalisation_tries: int = 4
    """... and a lost frame, or a keyframe of another piece."""
    piece_after: int = 30
    """Frames with depth for which a lost camera is looked for, before mapping goes on in a piece of its own; 0: it never does."""
    agreeing: int = 3
    """Keyframes in a row that must say the same of where two pieces lie before they become one ..."""
    agreeing_span: float = 0.3
    """... the last so far [m] from the first, or turned as much 2 m ahead: places that look alike do so for a while."""
    slack: float = 0.15
    """A loop may correct this [m] ..."""
    drift: float = 0.03
    """... and so much a metre of the way round it; more is another place that looks alike."""
    turn_slack: float = 3.0
    """The same for its turn [degrees] ..."""
    turn_drift: float = 0.3
    """... [degrees] a metre."""
    confirmed_within: float = 1.0
    """A second loop, from no farther than this [m], must ask for the same correction."""
    relearnt: int = 6
    """Map updates that replay a keyframe which a loop has moved, instead of a random one, until the map has followed."""


@dataclass(frozen=True)
class MeshConfig:
    """Extraction of the surface."""

    resolution: float = 0.02
    """Edge of the marching-cubes cells [m]."""


@dataclass(frozen=True)
class Config:
    """All of it."""

    preset: Literal["fast", "paper"] = "fast"
    """The preset that these values came from."""
    seed: int = 0
    """Seed of every random choice."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where the networks run; auto: a GPU when there is one."""
    front_end: str = "alignment"
    """Tracks frames: "alignment" to the map, helped by the neural tracker where in doubt; "registration" by the tracker alone (paper)."""
    map_representation: str = "neural_field"
    """The map: "neural_field", one network of T-SDF and colour."""
    back_end: str = "keyframe_mapping"
    """What keyframes do: "keyframe_mapping", the map learns from them and from replayed ones."""
    refine: bool = True
    """After the last frame, polish all keyframes' poses and the map together (mapper.final_...)."""
    field: FieldConfig = FieldConfig()
    mapper: MapperConfig = MapperConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    tracker: TrackerConfig = TrackerConfig()
    finetune: FinetuneConfig = FinetuneConfig()
    alignment: AlignmentConfig = AlignmentConfig()
    loops: LoopConfig = LoopConfig()
    mesh: MeshConfig = MeshConfig()
