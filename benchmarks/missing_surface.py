"""What is missing of a surface: was it ever measured?

    python benchmarks/missing_surface.py RECORDING MESH [--gt-mesh FILE] [--points 60000]

RECORDING has true poses; MESH is the mesh.ply of a run of it, whose world begins at the first frame; FILE is the true surface, which
generated recordings know. Of points on it those count that the protocol `seen` asks for. A reading lies on a point if it is off by less
than 5 mm and a Kinect's noise (6 mm times the squared depth). It prints a table in Markdown: by the number of readings the share of the
points, of those the share that is farther than 5 cm from the mesh, and what part of all missing points these are.
"""

import argparse
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.datasets import open_recording
from idfslam.datasets.recording import Dataset
from idfslam.evaluation.culling import in_any_view
from idfslam.evaluation.depth_range import depth_range
from idfslam.evaluation.evaluate import load_mesh
from idfslam.evaluation.protocols import find_protocol
from idfslam.evaluation.surface_samples import SurfaceSamples, to_surface
from idfslam.geometry.ray_casting import RayCaster

MISSING = 0.05  # [m] from the mesh
OFFSET, NOISE = 0.005, 0.006  # [m] and [1/m] times the squared depth: a reading that is off by less lies on the point
ROWS = ((0, 0), (1, 1), (2, 3), (4, 9), (10, 29), (30, None))  # numbers of readings


def readings_on(points: NDArray[np.float64], recording: Dataset, poses: NDArray[np.float64]) -> NDArray[np.int64]:
    """(N,) the number of frames with a reading on each point (N, 3)."""
    camera, count = recording.camera, np.zeros(len(points), np.int64)
    for i in range(len(recording)):
        x, y, z = (points @ (T := np.linalg.inv(poses[i]))[:3, :3].T + T[:3, 3]).T
        ahead = np.maximum(z, 1e-6)
        u, v = (np.rint(f * s / ahead + c).astype(np.int64) for f, s, c in ((camera.fx, x, camera.cx), (camera.fy, y, camera.cy)))
        inside = (z > 0) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        depth = recording[i].depth[np.where(inside, v, 0), np.where(inside, u, 0)]
        count += inside & (depth > 0) & (np.abs(depth - z) < OFFSET + NOISE * z**2)
    return count


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", help="with true poses")
    parser.add_argument("mesh", type=Path)
    parser.add_argument("--gt-mesh", type=Path, help="the true surface; default: the recording's own")
    parser.add_argument("--points", type=int, default=60_000, help="on the whole true surface")
    arguments = parser.parse_args()
    recording = open_recording(arguments.recording)
    truth, poses = recording.surface() if arguments.gt_mesh is None else load_mesh(arguments.gt_mesh), np.asarray(recording.ground_truth)
    if truth is None:
        parser.error(f"found no true surface of {arguments.recording}; expected --gt-mesh, or a generated recording")
    rule, sensor_range = find_protocol("seen").rule, depth_range(recording)
    if sensor_range is not None:
        rule = rule.limited_to(sensor_range)
    points = SurfaceSamples.of(truth, arguments.points, seed=0).points
    points = points[in_any_view(points, poses, recording.camera, rule, occluder=RayCaster(truth))]
    mesh: trimesh.Trimesh = load_mesh(arguments.mesh).apply_transform(poses[0])
    missing = to_surface(points, SurfaceSamples.of(mesh, 200_000, seed=0), mesh)[0] > MISSING
    count = readings_on(points, recording, poses)
    print(f"{len(points)} points to {rule.far:.2f} m, {100 * (1 - missing.mean()):.1f} % within {100 * MISSING:.0f} cm\n")
    print("| readings | points [%] | of these missing [%] | of all missing [%] |\n|---|---:|---:|---:|")
    for least, most in ROWS:
        row = (count >= least) & (count <= (count.max() if most is None else most))
        name = f"{least}" if least == most else f"{least} and more" if most is None else f"{least} to {most}"
        shares = row.mean(), missing[row].mean() if row.any() else np.nan, missing[row].sum() / max(missing.sum(), 1)
        print(f"| {name} | " + " | ".join(f"{100 * share:.1f}" for share in shares) + " |")


if __name__ == "__main__":
    main()
