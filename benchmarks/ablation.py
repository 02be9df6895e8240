"""What each part of the system contributes: the full `paper` preset, and the same without one part at a time, one seed.

    python benchmarks/ablation.py RECORDING [--frames 100] [--out ablation.json] [--set SECTION.KEY=VALUE ...] [--only NAME ...]

RECORDING is a folder with ground truth or `synthetic`. The sizes are those of a CPU (REDUCED), not the paper's 1024 pixels and 144
samples. Within 100 frames the paper's thresholds keep fewer keyframes than the 10 that finetuning waits for, so that all runs here,
the full one too, ask for keyframes sooner, cull later, and finetune from the third on. --set changes any value of all runs.
The completion ratio (share of true surface found within 5 cm, protocol `seen`) needs a true surface; without one there is a dash.
"""

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from idfslam.compute.process import prepare_process

prepare_process()

import numpy as np  # noqa: E402
import yaml  # noqa: E402

from idfslam.benchmark.reproduction.suite import ABLATIONS, REDUCED  # noqa: E402
from idfslam.config import Config, check, preset, update  # noqa: E402
from idfslam.datasets import open_recording  # noqa: E402
from idfslam.datasets.recording import Dataset  # noqa: E402
from idfslam.errors import DivergedError  # noqa: E402
from idfslam.evaluation.mesh_error import mesh_error  # noqa: E402
from idfslam.evaluation.trajectory_error import absolute_trajectory_error  # noqa: E402
from idfslam.frame import Frame, Status  # noqa: E402
from idfslam.geometry.depth_view import DepthView  # noqa: E402
from idfslam.mapping.meshing import extract_mesh  # noqa: E402
from idfslam.slam import Slam  # noqa: E402

SOONER: dict[str, Any] = {"keyframes": {"translation": 0.08, "rotation": 6.0, "cull": 0.9}, "finetune": {"keyframes": 3}}


def nested(assignment: str) -> dict[str, Any]:
    """`section.key=value`, the value as YAML has it, as the mapping that `config.update` takes."""
    name, value = assignment.split("=", 1)
    section, key = name.split(".")
    return {section: {key: yaml.safe_load(value)}}


def configured(changes: Sequence[dict[str, Any]]) -> Config:
    """The paper's preset with one change after the other."""
    config = preset("paper")
    for change in changes:
        config = update(config, change, "ablation")
    return check(config)


def completion_ratio(slam: Slam, recording: Dataset, truth: np.ndarray, T_gt_est: np.ndarray) -> float | None:
    """Share of the true surface within 5 cm of the map's; None where the recording has no true surface."""
    surface = recording.surface()
    if surface is None:
        return None
    views = [DepthView(k.T_wk.numpy(), k.frame.depth, k.frame.camera) for k in slam.graph.keyframes]
    config = slam.config
    mesh = extract_mesh(slam.mapper.field.sdf, None, views, resolution=0.03, truncation=config.field.truncation, device=slam.device)
    if len(mesh.faces) == 0:
        return 0.0
    poses, camera = truth[::10], recording.camera
    return mesh_error(mesh, surface, poses=poses, camera=camera, T_gt_est=T_gt_est, samples=20_000, views=1).completion_ratio


def measure(config: Config, recording: Dataset, frames: Sequence[Frame]) -> dict[str, Any]:
    """One run: its figures, or where it diverged."""
    slam, began = Slam(config), time.perf_counter()
    finetuned = 0
    for frame in frames:
        try:
            finetuned += any(name.startswith("finetune") for name in slam.process(frame).losses)
        except DivergedError as error:
            return {"diverged": f"frame {frame.index}: {error}"}
    seconds = time.perf_counter() - began
    truth = np.asarray(recording.ground_truth)[: len(frames)]
    ate = absolute_trajectory_error(slam.trajectory(), truth)
    return {
        "ate_cm": ate.translation.rmse * 100,
        "completion_ratio": completion_ratio(slam, recording, truth, ate.T_gt_est),
        "seconds": seconds,
        "keyframes": len(slam.graph.keyframes),
        "lost": sum(status is Status.LOST for status in slam.statuses()),
        "finetuning_steps": finetuned,
    }


def row(name: str, result: dict[str, Any]) -> str:
    """A line of the table."""
    if "diverged" in result:
        return f"| {name} | diverged: {result['diverged']} |"
    share = "-" if result["completion_ratio"] is None else f"{result['completion_ratio']:.1%}"
    counts = f"{result['keyframes']} | {result['lost']} | {result['finetuning_steps']}"
    return f"| {name} | {result['ate_cm']:.2f} | {share} | {counts} | {result['seconds']:.0f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path("ablation.json"))
    parser.add_argument("--set", dest="values", nargs="*", default=[], metavar="SECTION.KEY=VALUE")
    parser.add_argument("--only", nargs="*", default=list(ABLATIONS), choices=list(ABLATIONS))
    arguments = parser.parse_args()
    recording = open_recording(arguments.recording, frames=arguments.frames)
    frames = [recording[i] for i in range(len(recording))]
    common = [dict(REDUCED), SOONER, *map(nested, arguments.values)]
    print("| run | ATE [cm] | completion < 5 cm | keyframes | lost | finetuning steps | seconds |\n" + "|---" * 7 + "|")
    results: dict[str, Any] = {}
    for name in arguments.only:
        results[name] = measure(configured([*common, dict(ABLATIONS[name])]), recording, frames)
        print(row(name, results[name]), flush=True)
        report = {"recording": arguments.recording, "frames": len(frames), "common": common, "runs": results}
        arguments.out.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
