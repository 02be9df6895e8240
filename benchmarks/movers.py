"""What moves in generated rooms: how far it draws the path away, how well it is masked, and what is left of it in the mesh.

    python benchmarks/movers.py [--frames 300] [--kind people|movers] [--noise kinect|none|handheld] [--movers mask|off] [--seed 0] ROOM...
    python benchmarks/movers.py --cases [--noise kinect|none|handheld] [--movers mask|off] [--seed 0] ROOM...

For each room (a number) it runs the fast preset at 320x240 on the static twin and on the recording with what moves; with `--cases` on
each hard case of `datasets/generated/hard_cases.py`. It prints a row of a table for each:

- ATE of the whole, and the largest error of a live pose since the first [cm].
- IoU: of all pixels with depth, over the frames, of the masks while the camera moves; then of those of the archive's images at the end.
- Ghosts: cells of 5 cm in which the mesh has vertices farther than 5 cm from the static surface, and which a body passed through, as a
  share of all cells that a body passed through.
- Kept: of the vertices of the twin's mesh, the share that the mesh has too, to 3 cm. And of those that were seen: in view, and not hidden
  by a body, in at least 3 of every third frame.
"""

import argparse
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from idfslam.compute.process import prepare_process

prepare_process()

import trimesh  # noqa: E402
from numpy.typing import NDArray  # noqa: E402
from scipy.spatial import cKDTree  # noqa: E402

from idfslam.config import FAST, Config  # noqa: E402
from idfslam.datasets.generated.faults import Faults  # noqa: E402
from idfslam.datasets.generated.handheld import HandheldRecording, handheld_room  # noqa: E402
from idfslam.datasets.generated.hard_cases import HARD_CASE_SECONDS, HARD_CASES  # noqa: E402
from idfslam.datasets.generated.rendered import FPS  # noqa: E402
from idfslam.datasets.generated.room import SyntheticRoom  # noqa: E402
from idfslam.datasets.prefetch import Prefetch  # noqa: E402
from idfslam.errors import FrameError  # noqa: E402
from idfslam.evaluation.trajectory_error import absolute_trajectory_error  # noqa: E402
from idfslam.scenes.moving_scene import MovingScene  # noqa: E402
from idfslam.slam import Slam  # noqa: E402

CELL, OFF = 0.05, 0.05  # [m] of a cell, and from the static surface
SAMPLES = 1_000_000  # points of the true surface
KEPT, SEEN, EVERY, VIEWS = 0.03, 0.03, 3, 3  # [m] of a vertex to a mesh, and to a reading; every so many frames; views that saw a vertex
Recording = SyntheticRoom | HandheldRecording
Cells = set[tuple[int, ...]]


@dataclass
class Run:
    """What a run of a recording gave."""

    recording: Recording
    ate: float  # [cm]
    worst: float  # [cm] of the live poses
    statuses: dict[str, int]
    iou: float
    iou_at_end: float  # of the archive's images
    masked: float  # [1] share of the pixels
    milliseconds: float  # a frame, for masks
    mesh: trimesh.Trimesh  # in the recording's world
    seen: NDArray[np.int32] | None  # in how many frames the vertices of another mesh were seen

    def row(self, name: str, twin: "Run | None") -> str:
        iou = ghosts = kept = ""
        if twin is not None and self.seen is not None:
            iou, ghosts = f"{self.iou:.2f}, {self.iou_at_end:.2f}", f"{ghost_share(self):.2f} %"
            near = cKDTree(self.mesh.vertices).query(twin.mesh.vertices)[0] < KEPT
            kept = f"{100 * near.mean():.1f}, {100 * near[self.seen >= VIEWS].mean():.1f} %"
        texts = (
            f"{self.ate:.2f}",
            f"{self.worst:.1f}",
            self.statuses,
            iou,
            ghosts,
            kept,
            f"{100 * self.masked:.1f} %",
            f"{self.milliseconds:.1f}",
        )
        return "| " + " | ".join(map(str, (name, *texts))) + " |"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("rooms", nargs="+", type=int)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--kind", choices=("people", "movers"), default="people")
    parser.add_argument("--cases", action="store_true")
    parser.add_argument("--noise", choices=("kinect", "none", "handheld"), default="kinect")
    parser.add_argument("--movers", choices=("mask", "off"), default="mask")
    parser.add_argument("--seed", type=int, default=0)
    a = parser.parse_args()
    kinds, frames = (list(HARD_CASES), round(HARD_CASE_SECONDS * FPS)) if a.cases else ([a.kind], a.frames)
    config = replace(FAST, movers=a.movers, seed=a.seed)
    print("| room | ATE [cm] | worst [cm] | frames | IoU, at the end | ghosts | kept, of what was seen | masked | masks [ms a frame] |")
    print("|---|---:|---:|---|---:|---:|---:|---:|---:|", flush=True)
    for room in a.rooms:
        twin = run(opened(room, None, a.noise, frames), config)
        print(twin.row(f"{room}, static twin", None), flush=True)
        for kind in kinds:
            print(run(opened(room, kind, a.noise, frames), config, twin).row(f"{room}, {kind}", twin), flush=True)


def opened(room: int, kind: str | None, noise: str, frames: int) -> Recording:
    if noise == "handheld":
        return handheld_room(Faults.named("shutter+time"), room, frames, 320, 240, movers=kind)
    return SyntheticRoom(room, frames, 320, 240, noise=noise == "kinect", movers=kind)


def run(recording: Recording, config: Config, twin: Run | None = None) -> Run:
    slam = Slam(config)
    both, either, masked = 0, 0, 0.0
    seen = None if twin is None else np.zeros(len(twin.mesh.vertices), np.int32)
    for i, frame in Prefetch(recording):
        if isinstance(frame, FrameError):
            raise frame
        shown = slam.process(frame).moving
        cells = np.zeros(frame.depth.shape, np.bool_) if shown is None else shown & (frame.depth > 0)
        truth = recording.moving(i) & (frame.depth > 0)
        both, either, masked = both + int((cells & truth).sum()), either + int((cells | truth).sum()), masked + float(cells.mean())
        if twin is not None and seen is not None and i % EVERY == 0:
            seen += sees(recording, i, np.where(truth, 0, frame.depth), np.asarray(twin.mesh.vertices))
    slam.finish()
    T, live, true = recording.ground_truth[0], slam.live_trajectory(), recording.ground_truth
    ate = 100 * float(absolute_trajectory_error(slam.trajectory(), true).translation.rmse)
    worst = 100 * float(np.linalg.norm((T @ live)[:, :3, 3] - true[:, :3, 3], axis=1).max())
    statuses = dict(Counter(status.value for status in slam.statuses()))
    milliseconds = float(np.sum(slam.timings.get("segment", [0.0]))) / len(recording)
    mesh = slam.mesh()
    mesh.apply_transform(T)
    return Run(
        recording,
        ate,
        worst,
        statuses,
        both / max(either, 1),
        iou_at_end(slam, recording),
        masked / len(recording),
        milliseconds,
        mesh,
        seen,
    )


def iou_at_end(slam: Slam, recording: Recording) -> float:
    """Of the masks of the archive's images, after `finish`: a person who stood there from the beginning is known by then."""
    archive, both, either = slam.archive(), 0, 0
    assert archive is not None
    for i, view in enumerate(archive.views):
        measured = recording[view.index].depth > 0
        shown, truth = archive.moving(i) & measured, recording.moving(view.index) & measured
        both, either = both + int((shown & truth).sum()), either + int((shown | truth).sum())
    return both / max(either, 1)


def sees(recording: Recording, i: int, depth: NDArray[np.float32], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(N,) the points (N, 3) of the world that depth (H, W) shows: that of what does not move."""
    T, camera = np.linalg.inv(recording.ground_truth[i]), recording.camera
    x, y, z = (points @ T[:3, :3].T + T[:3, 3]).T
    ahead = np.maximum(z, 1e-6)
    u, v = (np.rint(f * s / ahead + c).astype(np.int64) for f, s, c in ((camera.fx, x, camera.cx), (camera.fy, y, camera.cy)))
    inside = (z > 0.1) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    return np.asarray(inside & (np.abs(depth[np.where(inside, v, 0), np.where(inside, u, 0)] - z) < SEEN))


def ghost_share(of: Run) -> float:
    """[%] of the cells that bodies passed through, those in which the mesh has what is not there."""
    scene = of.recording._scene
    assert isinstance(scene, MovingScene)
    surface = cKDTree(trimesh.sample.sample_surface(of.recording.surface(), SAMPLES, seed=0)[0])
    vertices = np.asarray(of.mesh.vertices)
    off = cells_of(vertices[surface.query(vertices)[0] > OFF])
    swept = swept_cells(scene, of.recording.timestamps)
    return 100 * len(off & swept) / len(swept)


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
