"""People in generated rooms: how far they draw the path away, how well they are masked, and what is left of them in the mesh.

    python benchmarks/movers.py [--frames 300] [--noise kinect|none|handheld] [--movers mask|off] [--seed 0] ROOM...

For each room (a number) it runs the fast preset at 320x240 on the recording with people and on its static twin. IoU: of all pixels with
depth, over the frames. Ghosts: cells of 5 cm in which the mesh has vertices farther than 5 cm from the static surface, and which a body
passed through, as a share of all cells that a body passed through.
"""

import argparse
from collections import Counter
from dataclasses import replace
from typing import Literal

import numpy as np

from idfslam.compute.process import prepare_process

prepare_process()

import trimesh  # noqa: E402
from numpy.typing import NDArray  # noqa: E402
from scipy.spatial import cKDTree  # noqa: E402

from idfslam.config import FAST  # noqa: E402
from idfslam.datasets.generated.faults import Faults  # noqa: E402
from idfslam.datasets.generated.handheld import HandheldRecording, handheld_room  # noqa: E402
from idfslam.datasets.generated.room import SyntheticRoom  # noqa: E402
from idfslam.datasets.prefetch import Prefetch  # noqa: E402
from idfslam.errors import FrameError  # noqa: E402
from idfslam.evaluation.trajectory_error import absolute_trajectory_error  # noqa: E402
from idfslam.scenes.moving_scene import MovingScene  # noqa: E402
from idfslam.slam import Slam  # noqa: E402

CELL, OFF = 0.05, 0.05  # [m] of a cell, and from the static surface
SAMPLES = 1_000_000  # points of the true surface
Cells = set[tuple[int, ...]]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("rooms", nargs="+", type=int)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--noise", choices=("kinect", "none", "handheld"), default="kinect")
    parser.add_argument("--movers", choices=("mask", "off"), default="mask")
    parser.add_argument("--seed", type=int, default=0)
    a = parser.parse_args()
    for room in a.rooms:
        for kind in ("people", None):
            print(f"{room} {kind or 'static twin'}: {measured(opened(room, kind, a.noise, a.frames), a.movers, a.seed)}", flush=True)


def opened(room: int, kind: str | None, noise: str, frames: int) -> SyntheticRoom | HandheldRecording:
    if noise == "handheld":
        return handheld_room(Faults.named("shutter+time"), room, frames, 320, 240, movers=kind)
    return SyntheticRoom(room, frames, 320, 240, noise=noise == "kinect", movers=kind)


def measured(recording: SyntheticRoom | HandheldRecording, movers: Literal["mask", "off"], seed: int) -> str:
    slam = Slam(replace(FAST, movers=movers, seed=seed))
    both, either, masked = 0, 0, 0.0
    for i, frame in Prefetch(recording):
        if isinstance(frame, FrameError):
            raise frame
        shown = slam.process(frame).moving
        cells = np.zeros(frame.depth.shape, np.bool_) if shown is None else shown & (frame.depth > 0)
        truth = recording.moving(i) & (frame.depth > 0)
        both, either, masked = both + int((cells & truth).sum()), either + int((cells | truth).sum()), masked + float(cells.mean())
    slam.finish()
    ate = 100 * float(absolute_trajectory_error(slam.trajectory(), recording.ground_truth).translation.rmse)
    statuses = dict(Counter(status.value for status in slam.statuses()))
    segment = float(np.sum(slam.timings.get("segment", [0.0]))) / len(recording)
    share = 100 * masked / len(recording)
    text = f"ATE {ate:.2f} cm, {statuses}, {share:.2f} % masked, IoU {both / max(either, 1):.2f}, {segment:.1f} ms a frame for masks"
    return text + ghosts(recording, slam.mesh())


def ghosts(recording: SyntheticRoom | HandheldRecording, mesh: trimesh.Trimesh) -> str:
    """What is left of the bodies in a mesh, in words."""
    scene = recording._scene
    if not isinstance(scene, MovingScene):
        return ""
    T = recording.ground_truth[0]
    vertices = np.asarray(mesh.vertices) @ T[:3, :3].T + T[:3, 3]
    surface = cKDTree(trimesh.sample.sample_surface(recording.surface(), SAMPLES, seed=0)[0])
    off = cells_of(vertices[surface.query(vertices)[0] > OFF])
    swept = swept_cells(scene, recording.timestamps)
    return f", ghosts {len(off & swept)} of {len(swept)} cells ({100 * len(off & swept) / len(swept):.2f} %)"


def swept_cells(scene: MovingScene, timestamps: NDArray[np.float64]) -> Cells:
    """The cells that the bodies passed through: those of points on the bodies' own grids."""
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 9)] * 3), -1).reshape(-1, 3)
    swept: Cells = set()
    for t in timestamps[::3]:
        for shape in scene.bodies_at(float(t)).shapes:
            sizes = np.array([max(shape[1:3]), max(shape[1:3]), shape[3]]) if shape[0] == 1 else shape[1:4]
            inside = grid if shape[0] == 0 else grid[np.linalg.norm(grid, axis=1) <= 1]
            swept |= cells_of((inside * sizes) @ shape[7:16].reshape(3, 3).T + shape[4:7])
    return swept


def cells_of(points: NDArray[np.float64]) -> Cells:
    return {(int(x), int(y), int(z)) for x, y, z in np.unique(np.floor(points / CELL), axis=0)}


if __name__ == "__main__":
    main()
