"""The values of the maps: what they are, how they are learnt, and the surface that is made of them.

What `UserOption` marks, and what the sources mean, is said in config.py.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from idfslam.config.fields import Count, Positive, UserOption


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
class FusionConfig:
    """The volume of fused depth images that sharpens the map's surface at the end of a run."""

    enabled: bool = True
    """Fuse the depth images of mapped views at their final poses. Meshes and views of the map are sharper, and its file is larger."""
    voxel: Positive = 0.01
    """Edge of a voxel [m]. Larger ones are faster and smaller, and smooth more."""
    blocks: Count = 28_000
    """Largest number of blocks of 8 x 8 x 8 voxels. In scenes that need more, voxels are larger."""


@dataclass(frozen=True)
class MeshConfig:
    """Extraction of the mesh from the map."""

    resolution: UserOption[Positive] = 0.02
    """Cell edge of marching cubes [m]. Where fused depth shows what is not flat, it is halved. Half the value gives about four times the
    triangles."""
