"""Runs a peer's program with another Python, and feeds it the frames of a recording."""

import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import IO

import numpy as np
import trimesh

from idfslam.batch.executor import last_line
from idfslam.benchmark.peers import programs
from idfslam.benchmark.peers.peer import PeerError, PeerJob, PeerRun
from idfslam.benchmark.peers.programs.frame_stream import StreamFrame, StreamHeader, write_frame, write_header
from idfslam.benchmark.peers.programs.result_file import ProgramResult, read_result
from idfslam.runs.source import read_frames

_FOLDER = Path(programs.__file__).parent
_PATIENCE = 1800.0  # [s] after the last frame, for corrections and meshes; larger: a program that hangs is told later. Chosen by hand
_RESULT, _LOG = "result.npz", "stderr.txt"


def run_program(job: PeerJob, program: str, before: Sequence[str] = (), after: Sequence[str] = ()) -> PeerRun:
    """Runs `PYTHON PROGRAM.py BEFORE... RESULT AFTER...` with all frames of the recording on its stdin.

    Raises PeerError, with the last line that the program said or the signal that killed it, if it ends with an error.
    """
    result, log = job.folder / _RESULT, job.folder / _LOG
    command = [job.python, str(_FOLDER / f"{program}.py"), *before, str(result), *after]
    with log.open("wb") as stderr:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=stderr)
    assert process.stdin is not None
    try:
        fed = _feed(process.stdin, job)
        code = process.wait(_PATIENCE)
    except subprocess.TimeoutExpired:
        raise PeerError(f"did not end within {_PATIENCE / 60:.0f} minutes of the last frame") from None
    finally:
        process.kill()
        process.wait()
    if code:
        told = last_line(log.read_text(encoding="utf-8", errors="replace"), code)
        how = f"killed by {signal.Signals(-code).name}" if code < 0 else told
        raise PeerError(f"ended after {fed} of {len(job.recording)} frames: {how}")
    return _run_of(read_result(result))


def _feed(pipe: IO[bytes], job: PeerJob) -> int:
    """Writes all frames. Returns how many were taken: fewer than all if the program ended."""
    camera, fed = job.recording.camera, 0
    try:
        with pipe:
            size = camera.width, camera.height
            write_header(pipe, StreamHeader(*size, camera.fx, camera.fy, camera.cx, camera.cy, len(job.recording)))
            for frame, _ in read_frames(job.recording):
                colour = np.round(frame.colour * 255).astype(np.uint8)
                T_wc = None if job.poses is None else job.poses[frame.index]
                write_frame(pipe, StreamFrame(frame.timestamp, colour, frame.depth, T_wc))
                fed += 1
    except BrokenPipeError:
        pass
    return fed


def _run_of(result: ProgramResult) -> PeerRun:
    mesh = trimesh.Trimesh(result.vertices, result.faces, process=False)
    return PeerRun(result.poses, result.seconds, result.version, result.peak_memory_mb, mesh)
