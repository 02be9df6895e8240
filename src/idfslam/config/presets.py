"""The presets: `paper` holds the values of Sec. VI-A; `fast`, the default, is the system for use. `imap` and `nice` are our implementations
of the two systems that the paper compares itself with; docs/presets.md has the source of each value."""

from idfslam.config.config import Config
from idfslam.config.keyframe_sections import KeyframeConfig, LoopConfig
from idfslam.config.map_sections import FieldConfig, FusionConfig, JointMappingConfig, MapperConfig
from idfslam.config.tracking_sections import FinetuneConfig, InverseRenderingConfig, PretrainConfig, TrackerConfig

FAST = Config()

PAPER = Config(
    preset="paper",
    front_end="registration",
    refine=False,
    calibrate="off",
    movers="off",
    field=FieldConfig(encoding="positional", truncation=0.10, direction_frequencies=4, layers=8, width=256, skip=5, colour_width=128),
    mapper=MapperConfig(
        supervision="rendering",
        pixels=1024,
        step_pixels=0,
        samples=128,
        importance_samples=16,
        sharpness=10.0,  # 1 / tr, as in the published code of [25]; with 1, free space outweighs the surface
        photometric_weight=0.1,
        free_space_weight=10.0,
        truncation_weight=6000.0,
        every=0,
        background=False,
        redraw=1,
        light=False,
        pose_optimisation=True,
        learning_rate=0.005,
        first_iterations=500,
        iterations=100,
        pose_learning_rate=0.005,
        gradient_clip=1.0,
        warm_up=20,
    ),
    keyframes=KeyframeConfig(least_sharpness=0, cull=0.5, cull_reach=0, covisible=0.3, replay=10, replay_connected=0),
    tracker=TrackerConfig(
        matches=200,
        grid=4,
        query_stride=1,
        target_stride=1,
        mutual=False,
        consensus="random",
        truncation=0.0,
        refits=0,
        plane_steps=0,
        patches=False,
        min_inliers=30,
        min_inlier_share=0.2,
        min_agreement=0.0,
    ),
    finetune=FinetuneConfig(every=1, keyframes=10, learning_rate=1e-4, validate_every=0),
    loops=LoopConfig(enabled=False, relocalise=False),
    fusion=FusionConfig(enabled=False),
)

IMAP = Config(
    preset="imap",
    front_end="inverse_rendering",
    map_representation="volume_density",
    back_end="joint_mapping",
    refine=False,
    calibrate="off",
    movers="off",
    mapper=MapperConfig(
        pixels=200,
        step_pixels=0,
        samples=32,
        importance_samples=12,
        photometric_weight=5.0,
        free_space_weight=1.6,
        cells=8,
        learning_rate=2e-4,
        first_iterations=1500,
        iterations=10,
        every=5,
        background=False,
        light=False,
    ),
    keyframes=KeyframeConfig(choice="information_gain", least_sharpness=0, cull=1.0),
    finetune=FinetuneConfig(enabled=False),
    loops=LoopConfig(enabled=False, relocalise=False),
    fusion=FusionConfig(enabled=False),
    joint_mapping=JointMappingConfig(window=5, choice="loss", pose_learning_rate=1e-3, poses_from=0),
    inverse_rendering=InverseRenderingConfig(pixels=200, iterations=6, learning_rate=1e-3, photometric_weight=5.0, outliers=0),
)

NICE = Config(
    preset="nice",
    front_end="inverse_rendering",
    map_representation="occupancy_grids",
    back_end="joint_mapping",
    refine=False,
    calibrate="off",
    movers="off",
    mapper=MapperConfig(
        pixels=1000,
        step_pixels=1000,
        samples=32,
        importance_samples=16,
        photometric_weight=0.2,
        active_sampling=False,
        first_iterations=1500,
        iterations=60,
        every=5,
        background=False,
        light=False,
    ),
    keyframes=KeyframeConfig(choice="interval", interval=50, least_sharpness=0, cull=1.0),
    finetune=FinetuneConfig(enabled=False),
    loops=LoopConfig(enabled=False, relocalise=False),
    fusion=FusionConfig(enabled=False),
    joint_mapping=JointMappingConfig(window=5, choice="overlap", pose_learning_rate=1e-3, poses_from=4),
    inverse_rendering=InverseRenderingConfig(pixels=200, iterations=10, learning_rate=1e-3, photometric_weight=0.5),
)

PRESETS = {"fast": FAST, "paper": PAPER, "imap": IMAP, "nice": NICE}

PRETRAIN = PretrainConfig()
