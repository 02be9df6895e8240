"""A small result folder, map and checkpoint, written by the functions that a run writes them with."""

from pathlib import Path

import numpy as np
import torch

from helpers.grey_archive import grey_archive
from helpers.recordings import pose
from idfslam.config import FAST, FieldConfig
from idfslam.frame import FrameResult, Status
from idfslam.fusion.fuse import fuse
from idfslam.geometry.camera import Camera
from idfslam.geometry.depth_view import DepthView
from idfslam.geometry.trajectory import Trajectory, save_tum
from idfslam.mapping.field import Field
from idfslam.mapping.saved_map import save_map
from idfslam.runs import result_folder
from idfslam.runs.checkpoint import Checkpoints
from idfslam.runs.frame_log import FrameLog
from idfslam.runs.keyframes_file import EarlierKeyframe, KeyframeRecord, write_keyframes
from idfslam.runs.run_config import RecordingSource, write_config
from idfslam.storage import atomic_files
from idfslam.views.image_archive import save_archive

CAMERA = Camera(16, 12, 15.0, 15.0, 7.5, 5.5)
_FINGERPRINT = {"version of idf-slam": "0", "camera": str(CAMERA)}


def write(folder: Path, recording: Path) -> Path:
    """All results of two frames but map, mesh and pictures."""
    folder.mkdir()
    poses, stamps = np.stack([pose(0), pose(1)]), np.array([0.0, 0.1])
    save_tum(folder / result_folder.TRAJECTORY, Trajectory(stamps, poses))
    write_config(folder, FAST, RecordingSource(str(recording)))
    earlier = [EarlierKeyframe(RecordingSource("before"), 3, 0.5, poses[1], CAMERA)]
    write_keyframes(folder, KeyframeRecord(CAMERA, np.array([0, 1]), stamps, poses, earlier))
    log = FrameLog()
    for i in range(2):
        log.add(FrameResult(i, i / 10, poses[i], Status.OK, True, {"total": 0.5}), ms=100.0)
    log.save(folder / result_folder.FRAMES)
    figures = {"frames": 2, "seconds": 1.4, "frames_per_second": 10.0, "ms_per_frame": {"map": 25.0}, "ate_m": {"rmse": 0.01}}
    atomic_files.write_json(folder / result_folder.METRICS, {**figures, "interrupted": False, "keyframes": 2, "lost_frames": 0})
    atomic_files.write_json(folder / result_folder.EVALUATION, {"mesh": {"accuracy": 0.01, "completion": 0.02, "completion_ratio": 0.9}})
    return folder


def write_map(path: Path) -> Path:
    """A map of few weights and one view."""
    torch.manual_seed(0)
    field = Field(FieldConfig(levels=1, features=1, width=4, colour_width=4, table_log2=4, table_log2_max=4, coarsest=0.5, finest=0.5))
    views = [DepthView(pose(0), np.ones((12, 16), np.float32), CAMERA)]
    save_map(path, field, views, fuse(views, 0.1, 4))
    return path


def write_archive(path: Path) -> Path:
    """An archive of two images."""
    save_archive(path, grey_archive())
    return path


def write_checkpoint(folder: Path) -> Path:
    """A checkpoint of a state as those of a run are."""
    with Checkpoints(folder, _FINGERPRINT, every=1) as checkpoints:
        checkpoints.save(1, {"slam": {"graph": [{"index": 0, "T_wk": torch.eye(4), "images": 5}]}, "meter": {"seconds": 1.5}})
    return folder


def read_checkpoint(folder: Path) -> object:
    """The state in the folder's checkpoint."""
    with Checkpoints(folder, _FINGERPRINT) as checkpoints:
        return checkpoints.read()
