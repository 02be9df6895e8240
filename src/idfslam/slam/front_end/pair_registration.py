"""Registration of a view with one keyframe by the neural tracker (Sec. V)."""

from torch import Tensor

from idfslam.frame import Status
from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe
from idfslam.slam.front_end.registered_pose import RegisteredPose
from idfslam.slam.keyframe_features import KeyframeFeatures
from idfslam.tracking.tracker import Tracker


class PairRegistration:
    """Registers views with keyframes by features, or by patches alone where the pose is roughly known."""

    def __init__(self, tracker: Tracker, features: KeyframeFeatures) -> None:
        self.tracker, self.features = tracker, features

    def register(self, view: Keyframe, keyframe: Keyframe, near: Tensor | None = None) -> RegisteredPose | None:
        """The view's pose by features, wherever it is; None if it is lost.

        near: a pose T_wc (4, 4) that the view probably has. The keyframe's patches are looked for there first, in a fifth of the time. A
        registration by features ends with these patches as well. Not so while anything moves in the view: what is not recognised of it may
        have drawn the pose to another line of a pattern, where patches convince too.
        """
        if near is not None and view.moving is None and (found := self._register_near(view, keyframe, near)).result.convinces:
            return found
        result = self.tracker.track(self.features.of(view), self.features.of(keyframe))
        return None if result.status is Status.LOST else RegisteredPose(keyframe, result)

    def _register_near(self, view: Keyframe, keyframe: Keyframe, T_wc: Tensor) -> RegisteredPose:
        T_kc = (se3.inverse(keyframe.T_wk) @ T_wc).numpy()
        images = self.features.images_of(view), self.features.images_of(keyframe)
        return RegisteredPose(keyframe, self.tracker.track_near(*images, T_kc))
