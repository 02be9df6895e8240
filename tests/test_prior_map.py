"""A second recording is localised in the map of a first one, and extends it; through the command line, as people do it."""

import json
from pathlib import Path

import numpy as np
import pytest

from idfslam.cli.command_line import main
from idfslam.datasets import open_recording
from idfslam.geometry.trajectory import load_tum
from idfslam.mapping.saved_map import load_map
from idfslam.runs.prior_map import load_prior

pytestmark = pytest.mark.slow

FAST_RUN = ["--mapper.first-iterations", "60", "--refinement.updates", "4", "--mesh.resolution", "0.1", "--no-report"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The result folders of frames 0 to 57 of a room, and of frames 50 to 166, in the map of the first."""
    folder = tmp_path_factory.mktemp("prior")
    first, second = folder / "first", folder / "second"
    main(["run", "synthetic", "--frames", "20", "--stride", "3", "--out", str(first), *FAST_RUN])
    main(["run", "synthetic", "--start", "50", "--frames", "30", "--stride", "4", "--map", str(first), "--out", str(second), *FAST_RUN])
    return first, second


def test_the_second_lies_in_the_first_ones_world(runs: tuple[Path, Path]) -> None:
    truth = open_recording("synthetic").ground_truth
    assert truth is not None
    expected = (np.linalg.inv(truth[0]) @ truth)[50:170:4, :3, 3]
    found = load_tum(runs[1] / "trajectory.txt").poses[:, :3, 3]
    np.testing.assert_allclose(found, expected, atol=0.02)
    assert np.linalg.norm(found[0]) > 0.3  # not its own first camera


def test_keyframes_of_both_are_kept(runs: tuple[Path, Path]) -> None:
    before, after = (json.loads((folder / "keyframes.json").read_text()) for folder in runs)
    assert [k["index"] for k in after["earlier"]] == [k["index"] for k in before["keyframes"]]
    assert {k["source"]["path"] for k in after["earlier"]} == {"synthetic"}
    assert after["keyframes"]
    assert len(load_prior(runs[1]).keyframes) == len(after["earlier"]) + len(after["keyframes"])


def test_the_map_grew(runs: tuple[Path, Path]) -> None:
    first, second = (load_map(folder / "map.safetensors") for folder in runs)
    assert len(second.views) > len(first.views)
    assert second.mesh(0.05).area > 1.1 * first.mesh(0.05).area


def test_images_that_fit_no_better_than_the_first_ones(tmp_path: Path) -> None:
    """Stripes seen by keyframes far apart, as a live camera leaves them that drops frames: no reason to doubt the place."""
    first, second = tmp_path / "first", tmp_path / "second"
    main(["run", "synthetic:7", "--frames", "14", "--stride", "6", "--out", str(first), *FAST_RUN])
    main(["run", "synthetic:7", "--start", "40", "--frames", "3", "--map", str(first), "--out", str(second), *FAST_RUN])
    assert json.loads((second / "metrics.json").read_text())["lost_frames"] == 0


def test_a_map_without_its_recording(runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("map.safetensors", "keyframes.json", "config.yaml"):
        (tmp_path / name).write_bytes((runs[0] / name).read_bytes())
    config = (tmp_path / "config.yaml").read_text()
    (tmp_path / "config.yaml").write_text(config.replace("path: synthetic", "path: /nowhere/kitchen"))
    with pytest.raises(SystemExit, match="1"):
        main(["run", "synthetic", "--frames", "3", "--map", str(tmp_path), "--out", str(tmp_path / "out")])
    assert "none of its keyframes' images can be read again" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="1"):
        main(["run", "synthetic", "--frames", "3", "--map", str(tmp_path / "nothing")])
    assert "no such folder" in capsys.readouterr().err
