"""docs/formats.md names everything that the files of a run hold."""

import csv
import json
import re
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rich.console import Console
from safetensors import safe_open

from helpers.small_config import small
from idfslam.datasets import open_recording
from idfslam.evaluation.mesh_error import MeshError
from idfslam.evaluation.protocols import PROTOCOLS
from idfslam.evaluation.view_error import ViewError, summary
from idfslam.frame import Status
from idfslam.geometry.camera import Camera
from idfslam.mapping import saved_map
from idfslam.runs import checkpoint, result_folder
from idfslam.runs.keyframes_file import EarlierKeyframe, KeyframeRecord, write_keyframes
from idfslam.runs.run_config import RecordingSource
from idfslam.runs.runner import run
from idfslam.views import image_archive

PAGE = (Path(__file__).parent.parent / "docs/formats.md").read_text(encoding="utf-8")
NAMED = {re.sub(r"\d+", "N", name) for name in re.findall(r"`([\w.*-]+)`", PAGE)}


def unnamed(values: Any) -> set[str]:
    """The keys in JSON values that the page does not name."""
    return {key for key in keys(values) if re.sub(r"\d+", "N", key) not in NAMED}


def keys(values: Any) -> Iterator[str]:
    if isinstance(values, dict):
        for key, value in values.items():
            yield key
            yield from keys(value)
    elif isinstance(values, list):
        for value in values:
            yield from keys(value)


@pytest.fixture(scope="module")
def finished(box_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a real run of eight frames."""
    folder = tmp_path_factory.mktemp("formats") / "run"
    source = RecordingSource(str(box_recording), frames=8)
    run(open_recording(box_recording, frames=8), small(), folder, source=source, console=Console(quiet=True))
    return folder


def test_metrics(finished: Path) -> None:
    metrics = json.loads((finished / result_folder.METRICS).read_text())
    assert {"ate_m", "rpe_1", "live_ate_m", "loops", "submaps"} <= set(metrics)
    assert unnamed(metrics) == set()


def test_keyframes(finished: Path, tmp_path: Path) -> None:
    assert unnamed(json.loads((finished / result_folder.KEYFRAMES).read_text())) == set()
    camera, T = Camera(4, 3, 4.0, 4.0, 1.5, 1.0), np.eye(4)
    earlier = [EarlierKeyframe(RecordingSource("other"), 0, 0.0, T, camera)]
    write_keyframes(tmp_path, KeyframeRecord(camera, np.zeros(1, np.int64), np.zeros(1), T[None], earlier))
    values = json.loads((tmp_path / result_folder.KEYFRAMES).read_text())
    assert {"camera", "keyframes", "earlier"} <= set(values)
    assert unnamed(values) == set()


def test_frames(finished: Path) -> None:
    with (finished / result_folder.FRAMES).open(newline="") as file:
        columns = set(next(csv.reader(file)))
    assert {"index", "status", "total"} <= columns
    assert unnamed(dict.fromkeys(columns)) == set()
    assert {status.value for status in Status} <= NAMED


def test_evaluation() -> None:
    assert unnamed({field.name: None for field in fields(MeshError)}) == set()
    assert set(PROTOCOLS) <= NAMED


def test_config(finished: Path) -> None:
    values = yaml.safe_load((finished / result_folder.CONFIG).read_text())
    assert unnamed(values["recording"]) == set()
    assert "versions: idf-slam" in PAGE


def test_map(finished: Path) -> None:
    with safe_open(finished / result_folder.MAP, "pt") as file:
        metadata, tensors = file.metadata(), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (safe_open is no mapping)
    assert set(metadata) <= NAMED
    names = {re.sub(r"\.\d+\.", ".N.", name.replace("views.0.", "views.C.")) for name in tensors}
    assert names <= NAMED
    for line in PAGE.splitlines():
        if line.startswith(("| `field.", "| `views.C.")):
            name, dtype = line.split("`")[1].replace(".C.", ".0.").replace(".N.", ".0."), line.split("|")[2].split(",")[0].strip()
            assert str(tensors[name].dtype) == f"torch.{dtype}", name


def test_archive(finished: Path) -> None:
    with safe_open(finished / result_folder.ARCHIVE, "pt") as file:
        metadata, tensors = file.metadata(), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (safe_open is no mapping)
    assert set(metadata) <= NAMED
    assert set(tensors) <= NAMED
    assert set(tensors) == {"index", "T_wc", "colour", "colour_ends", "depth", "depth_ends", "exposures", "sharpness", "lit"}


def test_views() -> None:
    assert unnamed(summary([ViewError(0, 30.0, 0.9, 31.0, 0.0, 0.1)])) == set()


def test_versions() -> None:
    rows = {cells[1].strip(): cells[3].strip() for cells in (line.split("|") for line in PAGE.splitlines()) if len(cells) == 5}
    assert rows["`map.safetensors`"] == str(saved_map.FORMAT)
    assert rows["`archive.safetensors`"] == str(image_archive.FORMAT)
    assert rows["`checkpoint.safetensors`"] == str(checkpoint.FORMAT)
