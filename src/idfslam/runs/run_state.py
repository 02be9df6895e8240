"""The changing state of a run, which a checkpoint stores: the SLAM system, the clock and the log of frames."""

from collections.abc import Callable
from dataclasses import dataclass, field

from idfslam.frame import Frame, FrameResult
from idfslam.runs.frame_log import FrameLog
from idfslam.runs.meter import Meter
from idfslam.slam import Slam
from idfslam.storage.state import State
from idfslam.viewer.viewer import NO_VIEWER, Viewer


@dataclass(frozen=True, eq=False)
class RunState:
    """A SLAM system with the time and the log of the frames that it has processed. The clock starts when this object is created."""

    slam: Slam
    meter: Meter = field(default_factory=Meter)
    frame_log: FrameLog = field(default_factory=FrameLog)

    def process(self, frame: Frame, *, readable: bool = True, viewer: Viewer = NO_VIEWER) -> FrameResult:
        """Tracks and maps the next frame, shows it, and logs it. The time that the viewer takes counts as the frame's."""
        result = self.slam.process(frame)
        viewer.frame(frame, result, self.slam)
        self.frame_log.add(result, self.meter.frame(readable=readable))
        return result

    def state(self) -> State:
        """The state of all three."""
        return {"meter": self.meter.state(), "frame_log": self.frame_log.state(), "slam": self.slam.state()}

    def restore(self, state: State, frame: Callable[[int], Frame]) -> None:
        """Sets the state that `state` returned. `frame` reads the frame of an index again, as it was processed."""
        self.slam.restore(state["slam"], frame)
        self.meter.restore(state["meter"])
        self.frame_log.restore(state["frame_log"])
