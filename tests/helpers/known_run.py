"""A result folder made without tracking: true poses of the box room, and a map taught by them."""

from pathlib import Path

import numpy as np
import torch

from helpers.box_room import BOX_FRAMES, box_poses
from idfslam.config import FAST, FieldConfig, MapperConfig
from idfslam.datasets import open_recording
from idfslam.evaluation.plots import plot_trajectory
from idfslam.frame import FrameResult, Status
from idfslam.geometry.depth_view import DepthView
from idfslam.geometry.trajectory import Trajectory, save_tum
from idfslam.graph.keyframe import Keyframe
from idfslam.mapping.mapper import Mapper
from idfslam.mapping.saved_map import load_map, save_map
from idfslam.mapping.updates import InTurns
from idfslam.runs import result_folder
from idfslam.runs.frame_log import FrameLog
from idfslam.runs.keyframes_file import KeyframeRecord, write_keyframes
from idfslam.runs.run_config import RecordingSource, write_config
from idfslam.storage import atomic_files

KNOWN_KEYFRAMES = (0, 6, 13)
KNOWN_LOST = 4  # the frame whose status is lost
KNOWN_INTERPOLATED = 5  # the one that was lost, and lies between known ones now


def write_known_run(folder: Path, box_recording: Path) -> Path:
    """All that `idf-slam run` would write; frame 4 is lost, frame 5 interpolated."""
    torch.manual_seed(0)
    recording, poses = open_recording(box_recording), box_poses()
    folder.mkdir(parents=True)
    learner = Mapper(MapperConfig(), FieldConfig(table_log2=13), torch.device("cpu"), torch.Generator().manual_seed(0), InTurns())
    keyframes = []
    for i in KNOWN_KEYFRAMES:
        frame = recording[i]
        keyframes.append(Keyframe(frame, torch.from_numpy(poses[i]), torch.from_numpy(frame.depth), torch.from_numpy(frame.colour)))
    learner.optimise_map(keyframes, 200)
    save_map(folder / result_folder.MAP, learner.field, [DepthView(poses[k.frame.index], k.frame.depth, k.frame.camera) for k in keyframes])
    load_map(folder / result_folder.MAP).mesh(0.04).export(folder / result_folder.MESH)
    for name in (result_folder.TRAJECTORY, result_folder.LIVE):
        save_tum(folder / name, Trajectory(recording.timestamps, poses))
    indices = np.array(KNOWN_KEYFRAMES)
    write_keyframes(folder, KeyframeRecord(recording.camera, indices, recording.timestamps[indices], poses[indices]))
    write_config(folder, FAST, RecordingSource(str(box_recording)))
    known_log().save(folder / result_folder.FRAMES)
    plot_trajectory(folder / result_folder.PICTURE, poses)
    stages = {"align": 40.0, "map": 25.0, "finetune": 1.5}
    figures = {"frames": BOX_FRAMES, "seconds": 1.4, "frames_per_second": 10.0, "ms_per_frame": stages, "peak_memory_mb": 512.0}
    atomic_files.write_json(folder / result_folder.METRICS, {**figures, "keyframes": 3, "lost_frames": 1, "degenerate_frames": 0})
    return folder


def known_log() -> FrameLog:
    """Frame 4 is lost, frame 5 interpolated, the keyframes have losses."""
    log = FrameLog()
    for i, T_wc in enumerate(box_poses()):
        losses = {"total": 0.5 / (i + 1), "photometric": 0.125} if i in KNOWN_KEYFRAMES else {"finetune_depth": 0.25} if i == 9 else {}
        status = {KNOWN_LOST: Status.LOST, KNOWN_INTERPOLATED: Status.INTERPOLATED}.get(i, Status.OK)
        log.add(FrameResult(i, i / 30, T_wc, status, i in KNOWN_KEYFRAMES, losses), ms=100.0 + i)
    return log
