"""The values of keyframes: which are chosen, and how their poses are refined and loops closed.

What `UserOption` marks, and what the sources mean, is said in config.py.
"""

from dataclasses import dataclass
from typing import Literal

from idfslam.config.fields import Count, Positive, UserOption


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
