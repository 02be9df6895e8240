"""Writes the results of a run into its folder."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from idfslam.config import Config
from idfslam.datasets import FrameSource
from idfslam.evaluation.plots import plot_trajectory
from idfslam.geometry.trajectory import Trajectory, save_tum
from idfslam.runs import result_folder
from idfslam.runs.frame_log import FrameLog
from idfslam.runs.keyframes_file import KeyframeRecord, write_keyframes
from idfslam.runs.metrics import pose_errors
from idfslam.runs.prior_map import PriorMap
from idfslam.runs.run_config import RecordingSource, write_config
from idfslam.slam import Slam
from idfslam.storage import atomic_files
from idfslam.views.image_archive import save_archive


class ResultWriter:
    """Writes each file whole or not at all.

    recording: what the frames came from. source: how to open it again; None for frames that came from no file. prior: the map that the run
    started in. The methods raise OSError where a file cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        slam: Slam,
        recording: FrameSource,
        config: Config,
        *,
        source: RecordingSource | None = None,
        prior: PriorMap | None = None,
    ) -> None:
        self._folder, self._slam, self._recording = folder, slam, recording
        self._config, self._source, self._prior = config, source, prior

    def write_all(self, mesh: trimesh.Trimesh, frame_log: FrameLog, metrics: dict[str, Any]) -> None:
        """Every file of a complete run, the small ones first."""
        self.write_poses()
        self.write_frames(frame_log)
        self.write_map(mesh)
        atomic_files.write_json(self._folder / result_folder.METRICS, metrics)

    def write_poses(self) -> None:
        """The trajectory, also as it was reported at the time, and its picture, the keyframes, and the config."""
        trajectory, live = trajectory_of(self._slam, self._recording), self._slam.live_trajectory()
        with atomic_files.replacing(self._folder / result_folder.TRAJECTORY) as part:
            save_tum(part, trajectory)
        with atomic_files.replacing(self._folder / result_folder.LIVE) as part:
            save_tum(part, Trajectory(trajectory.timestamps[: len(live)], live), remark="each pose as it was reported at the time")
        keyframes = self._keyframes()
        write_keyframes(self._folder, keyframes)
        write_config(self._folder, self._config, self._source)
        with atomic_files.replacing(self._folder / result_folder.PICTURE) as part:
            self._draw_trajectory(part, keyframes)

    def write_map(self, mesh: trimesh.Trimesh) -> None:
        """The mesh, the neural map, and the images that views of it are made of."""
        data = mesh.export(file_type="ply")
        assert isinstance(data, bytes)
        with atomic_files.replacing(self._folder / result_folder.MESH) as part:
            part.write_bytes(data)  # not by its path: a full disk would leave the file open, and its room taken
        with atomic_files.replacing(self._folder / result_folder.MAP) as part:
            self._slam.save_map(part)
        if (archive := self._slam.archive()) is not None:
            with atomic_files.replacing(self._folder / result_folder.ARCHIVE) as part:
                save_archive(part, archive)

    def write_frames(self, frame_log: FrameLog) -> None:
        """The log of frames, with each frame's final status."""
        frame_log.set_final_statuses(self._slam.statuses())
        with atomic_files.replacing(self._folder / result_folder.FRAMES) as part:
            frame_log.save(part)

    def _keyframes(self) -> KeyframeRecord:
        """The run's own keyframes, and the prior map's at their present poses. A run starts with the prior map's, so these come first."""
        stored, prior = self._slam.stored_keyframes(), [] if self._prior is None else self._prior.keyframes
        own = [keyframe for keyframe in stored[len(prior) :] if keyframe.submap == 0]
        indices = np.array([keyframe.index for keyframe in own], np.int64)
        poses = np.array([keyframe.T_wk for keyframe in own], np.float64).reshape(-1, 4, 4)
        earlier = [replace(keyframe.record, T_wk=now.T_wk) for keyframe, now in zip(prior, stored)]
        stamps, covariances = self._recording.timestamps[indices], [keyframe.covariance for keyframe in own]
        return KeyframeRecord(self._recording.camera, indices, stamps, poses, earlier, covariances)

    def _draw_trajectory(self, path: Path, keyframes: KeyframeRecord) -> None:
        """The trajectory's picture, with the true trajectory if it is known and with the live poses if loops were closed."""
        errors, poses = pose_errors(self._slam, self._recording), self._slam.trajectory()
        truth, T_gt_est = None, None
        if errors is not None and self._recording.ground_truth is not None:
            truth, T_gt_est = self._recording.ground_truth[: len(poses)], errors.ate.T_gt_est
        before_loops = self._slam.live_trajectory() if self._slam.figures()["loops"] else None
        plot_trajectory(path, poses, truth, T_gt_est=T_gt_est, keyframes=keyframes.indices, before=before_loops)


def trajectory_of(slam: Slam, recording: FrameSource) -> Trajectory:
    """The poses of all frames processed, with their time stamps."""
    poses = slam.trajectory()
    return Trajectory(recording.timestamps[: len(poses)], poses)
