"""Exports a run, opens the files with other programs, and compares what they show with the run: a table of what fits.

    python benchmarks/open_exports.py results/my_recording --out /tmp/exports \\
        --blender BLENDER/bin/python --open3d OPEN3D/bin/python --others OTHERS/bin/python --three THREE

BLENDER, OPEN3D and OTHERS are virtual environments with bpy, open3d, and pymeshlab meshio pygltflib pycolmap; THREE is a folder in which
`npm install three gltf-validator` was called. What is not given is left out; trimesh and evo are here. Columns: `position` [mm], largest
distance of a vertex from the run's own mesh turned upright; `axes`, of the file as the program has it; `normals`, least share of normals
within 90 degrees of the surface's; `colours`, mean difference from the run's, of 255, as the program shows them.

--pictures also renders the first frame's view with Blender and with three.js in Chromium, without light, beside the recorded image.
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from idfslam.cli import command_line
from idfslam.export.axes import Axes
from idfslam.export.mesh_files import linear
from idfslam.export.run_surface import mesh_of_map
from idfslam.export.surface import turned
from idfslam.runs.finished_run import FinishedRun

HERE = Path(__file__).parent / "export_readers"
MESHES = ("mesh.ply", "mesh.obj", "mesh.glb", "points.ply")
RESOLUTION = 0.03


@dataclass(frozen=True)
class Arguments:
    """Where the programs are."""

    run: tyro.conf.Positional[Path]
    out: Path
    blender: Path | None = None
    open3d: Path | None = None
    others: Path | None = None
    three: Path | None = None
    pictures: bool = False


@dataclass(frozen=True)
class Reader:
    """A program that opens meshes."""

    command: Sequence[str | Path]
    files: Sequence[str]
    glb_up: str = "y"  # axis that points up after it opened a GLB file
    glb_linear: bool = True  # whether it hands out the colours of GLB as they are in the file


def readers(given: Arguments) -> list[Reader]:
    """Those that are there."""
    found = [Reader([sys.executable, HERE / "trimesh_.py"], MESHES)]
    if given.blender:
        found.append(Reader([given.blender, HERE / "blender.py"], MESHES, glb_up="z", glb_linear=False))
    if given.open3d:
        found.append(Reader([given.open3d, HERE / "open3d_.py"], MESHES))
    if given.three:
        found.append(Reader(["node", HERE / "three.mjs", given.three], MESHES, glb_linear=False))
    if given.others:
        found += [
            Reader([given.others, HERE / "meshlab.py"], MESHES),
            Reader([given.others, HERE / "meshio_.py"], ("mesh.ply", "points.ply")),
            Reader([given.others, HERE / "pygltflib_.py"], ("mesh.glb",)),
        ]
    return found


def opened(command: Sequence[str | Path], path: Path, *more: str | Path) -> dict[str, Any]:
    """What a reader printed in its last line."""
    done = subprocess.run([str(word) for word in (*command, path, *more)], capture_output=True, text=True, timeout=900)
    if done.returncode:
        return {"program": str(command[1]), "failed": (done.stderr.strip().splitlines() or ["no message"])[-1][:100]}
    return dict(json.loads(done.stdout.strip().splitlines()[-1]))


@dataclass(frozen=True, eq=False)
class Expected:
    """The surface of the run, upright: what every program should have."""

    points: NDArray[np.float64]  # (N, 3) [m], z up
    normals: NDArray[np.float64]  # (N, 3)
    colours: NDArray[np.float64]  # (N, 4) of 255

    def row(self, name: str, found: dict[str, Any], reader: Reader) -> list[str]:
        """A line of the table."""
        if "failed" in found:
            return [found["program"], name, found["failed"], "", "", ""]
        glb, cloud = name.endswith("glb"), name.startswith("points")
        up = reader.glb_up if glb else "z"
        turn = np.eye(3) if up == "z" else np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # back to z up
        distance, nearest = cKDTree(self.points).query(np.array(found["points"]) @ turn.T)
        position = f"{np.percentile(distance, 50 if cloud else 100) * 1000:.2f}"
        normals = np.array(found["normals"]) @ turn.T if found.get("normals") else None
        facing = "none" if normals is None else f"{((normals * self.normals[nearest]).sum(1) > 0).mean():.3f}"
        colours = "none"
        if found.get("colours"):
            expected = linear(self.colours) if glb and reader.glb_linear else self.colours
            colours = f"{np.abs(np.array(found['colours']) * 255 - expected[nearest, :3]).mean():.2f}"
            colours += " (linear)" if glb and reader.glb_linear else ""
        return [found["program"], name, position, f"{up} up", facing, colours]


def trajectory_rows(given: Arguments, run: FinishedRun, axes: Axes) -> list[list[str]]:
    """evo's and COLMAP's readers against the run's poses."""
    from importlib.metadata import version

    from evo.tools import file_interface

    expected = axes.T_ew @ run.trajectory.poses
    rows = []
    for name, read in (("tum.txt", file_interface.read_tum_trajectory_file), ("kitti.txt", file_interface.read_kitti_poses_file)):
        found = np.array(read(str(given.out / name)).poses_se3)
        rows.append([f"evo {version('evo')}", name, f"{np.abs(found - expected).max() * 1000:.5f}", "z up", "", ""])
    if given.others:
        found_model = opened([given.others, HERE / "colmap.py"], given.out / "colmap" / "sparse" / "0")
        worst = max(np.abs(np.array(T) - expected[int(Path(name).stem)]).max() for name, T in found_model["poses"].items())
        pixels = f"points reprojected: {found_model['reprojection']:.4f} px"
        rows.append([found_model["program"], "colmap/sparse/0", f"{worst * 1000:.5f}", "z up", "", pixels])
    return rows


def pictures(given: Arguments, run: FinishedRun, axes: Axes) -> list[list[str]]:
    """The first frame's view in other programs: mean difference from the recorded image, of 255, where there is surface."""
    camera = run.keyframes.camera
    view = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    (given.out / "view.json").write_text(json.dumps({**view, "T_ec": (axes.T_ew @ run.trajectory.poses[0]).tolist()}))
    recorded = np.round(run.recording[0].colour * 255)
    cv2.imwrite(str(given.out / "recorded.png"), recorded[..., ::-1].astype(np.uint8))
    commands: list[list[str | Path]] = [[given.blender, HERE / "blender.py"]] if given.blender else []
    if given.three:
        commands.append(["node", HERE / "browser.mjs", given.three])
    return [
        picture_row(given.out, name, command, recorded)
        for name in ("mesh.ply", "mesh.obj", "mesh.glb", "texture/mesh.glb")
        for command in commands
    ]


def picture_row(folder: Path, name: str, command: Sequence[str | Path], recorded: NDArray[np.floating]) -> list[str]:
    """One program's picture of one file beside the recorded image."""
    picture = folder / f"{name.replace('/', '_')}.{Path(command[1]).stem}.png"
    found = opened(command, folder / name, folder / "view.json", picture)
    if "failed" in found:
        return [found["program"], name, found["failed"], "", "", ""]
    image = np.asarray(cv2.imread(str(picture), cv2.IMREAD_UNCHANGED))
    shown = (image[..., 3] > 250) if image.shape[-1] == 4 else image.max(-1) > 0
    difference = np.abs(image[..., 2::-1].astype(float) - recorded)[shown].mean()
    return [found["program"], f"{name}, rendered", "", f"{shown.mean():.0%} of the view", "", f"{difference:.1f} from the recording"]


def main(given: Arguments) -> None:
    run, axes = FinishedRun(given.run), Axes.of(FinishedRun(given.run), "z")
    to = ("tum", "kitti", "nerfstudio", "colmap", "ply", "obj", "glb", "points")
    export = ["export", str(given.run), "--resolution", str(RESOLUTION), "--overwrite"]
    command_line.main([*export, "--to", *to, "--out", str(given.out)])
    command_line.main([*export, "--to", "obj", "glb", "--texture", "images", "--out", str(given.out / "texture")])
    mesh = turned(mesh_of_map(run, RESOLUTION), axes.T_ew)
    visual: Any = mesh.visual
    expected = Expected(np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals), np.asarray(visual.vertex_colors))
    rows = [expected.row(name, opened(reader.command, given.out / name), reader) for reader in readers(given) for name in reader.files]
    rows += trajectory_rows(given, run, axes)
    if given.pictures:
        rows += pictures(given, run, axes)
    print("| program | file | position [mm] | axes | normals | colours |\n|---|---|---|---|---|---|")
    print("\n".join(f"| {' | '.join(row)} |" for row in rows))


if __name__ == "__main__":
    main(tyro.cli(Arguments))
