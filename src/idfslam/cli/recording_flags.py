"""The flags of commands that read recordings or cameras: the frames, the camera, the topics; and what they open together."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from idfslam.runs.run_config import RecordingSource


@dataclass(frozen=True)
class RecordingFlags:
    """Which frames are used, and how the recording is read."""

    start: int = 0
    """First frame to use."""
    frames: int | None = None
    """Number of frames to use. Default: all."""
    stride: int = 1
    """Use every N-th frame."""
    format: str | None = None
    """Force the input format. Default: detected from the files."""
    camera_file: Path | None = None
    """File of a camera that replaces the recording's: as `idf-slam calibrate` writes it, or any that may lie beside images.
    --camera.fx and so on replace its values."""


@dataclass(frozen=True)
class CameraFlags:
    """The pinhole camera. These values replace those of the recording."""

    fx: float | None = None
    """Focal length along x [px]."""
    fy: float | None = None
    """Focal length along y [px]."""
    cx: float | None = None
    """Principal point along x [px]. Pixel centres lie at integers."""
    cy: float | None = None
    """Principal point along y [px]."""
    guess: bool = False
    """If nothing is known of the camera, start from a usual one, whose image is 65 degrees wide. `run` then finds the camera from the
    images before it maps, unless --calibrate is off."""
    field_of_view: float | None = None
    """The same from this width of the image [degrees]."""
    depth_scale: float | None = None
    """Units of the depth images per metre; 1000 for millimetres."""
    reach: float | None = None
    """Depth from here on counts as no reading [m], where a sensor clips what is farther. Default: all depth counts."""
    readout: float | None = None
    """Read-out time of the colour images, from their first row to their last [s]; 0 for a global shutter. Default of the three times: the
    recording's, else they are unknown and estimated while it runs (front end `alignment`)."""
    depth_readout: float | None = None
    """The same of the depth images [s]."""
    depth_delay: float | None = None
    """Time by which depth is taken later than its time stamps say [s]; negative: earlier."""

    def given(self) -> dict[str, float]:
        """Those that are given; a guess as the field of view that it is made from."""
        from idfslam.datasets.cameras.calibration import USUAL_FIELD_OF_VIEW

        values = {key: value for key, value in asdict(self).items() if value is not None and key != "guess"}
        return {"field_of_view": USUAL_FIELD_OF_VIEW} | values if self.guess else values


@dataclass(frozen=True)
class TopicFlags:
    """Topics of a ROS recording. Default: detected from their types and names."""

    colour: str | None = None
    """Topic of the colour images."""
    depth: str | None = None
    """Topic of the depth images. They count as registered to colour unless the recording says otherwise."""
    camera_info: str | None = None
    """Topic of the colour camera's calibration."""
    poses: str | None = None
    """Topic of the true poses: of the camera, or of a frame that /tf_static connects with it."""


def recording_source(
    path: Path, flags: RecordingFlags, camera: CameraFlags, topics: TopicFlags | None = None, *, truth: bool = True
) -> "RecordingSource":
    """The recording or live camera that the flags name, with its path made absolute. truth: False leaves the ground truth unread."""
    from idfslam.live import absolute_path
    from idfslam.runs.run_config import RecordingSource

    given = camera.given()
    depth_scale = given.pop("depth_scale", None)
    return RecordingSource(
        absolute_path(str(path)),
        format=flags.format,
        camera=given or None,
        camera_file=None if flags.camera_file is None else str(flags.camera_file.absolute()),
        depth_scale=depth_scale,
        topics={name: topic for name, topic in asdict(topics or TopicFlags()).items() if topic is not None} or None,
        start=flags.start,
        frames=flags.frames,
        stride=flags.stride,
        truth=truth,
    )
