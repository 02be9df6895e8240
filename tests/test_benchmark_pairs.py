"""The benchmark of pairs: errors by hand, every method on the box room, JSON, table and pictures, and what goes wrong."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from idfslam.benchmark import registration_methods
from idfslam.benchmark.icp import icp_installed
from idfslam.benchmark.keypoints import KeypointDetector
from idfslam.benchmark.pair_sample import sample
from idfslam.benchmark.pairs import Tally, bench_pairs
from idfslam.benchmark.registration_methods import baselines, learned
from idfslam.cli.command_line import main
from idfslam.config import FAST, TrackerConfig
from idfslam.datasets import open_recording
from idfslam.errors import ConfigError, RecordingError, pip_install
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.pretraining.validation import pose_error


def test_errors_by_hand() -> None:
    # Truth: a quarter turn about z and (1, 2, 3). Found: 0.1 rad further about z, and 3 cm and 4 cm off along world x and y: 5 cm.
    def turned(angle: float, *shift: float) -> np.ndarray:
        c, s = math.cos(angle), math.sin(angle)
        return np.array([[c, -s, 0, shift[0]], [s, c, 0, shift[1]], [0, 0, 1, shift[2]], [0, 0, 0, 1]])

    rotation, translation = pose_error(turned(math.pi / 2 + 0.1, 1.03, 2.04, 3.0), turned(math.pi / 2, 1, 2, 3))
    assert rotation == pytest.approx(math.degrees(0.1))
    assert translation == pytest.approx(5.0)


def test_figures_by_hand() -> None:
    # Rotations 1, 6, 20 degrees, translations 2, 7, 30 cm; wrong is beyond 5 degrees or 15 cm: the last two, of which one was believed.
    tally = Tally([1, 6, 20], [2, 7, 30], [True, True, False], [10, 12, 11, 10, 12, 11], [5, 6, 7])
    figures = {key: round(value or 0.0, 3) for key, value in tally.figures().items()}
    assert (figures["rotation_below_5_deg"], figures["rotation_below_10_deg"]) == (0.333, 0.667)
    assert [figures[f"translation_below_{limit}_cm"] for limit in (5, 10, 25)] == [0.333, 0.667, 0.667]
    assert (figures["rotation_mean_deg"], figures["rotation_median_deg"]) == (9.0, 6.0)
    assert (figures["translation_mean_cm"], figures["translation_median_cm"]) == (13.0, 7.0)
    assert (figures["believed"], figures["believed_but_wrong"]) == (0.667, 0.333)
    # Right is within 5 degrees and 10 cm: the first alone. Of two believed one is right; of two that are not right one was doubted.
    assert (figures["right_of_believed"], figures["doubted_of_not_right"]) == (0.5, 0.5)
    assert (figures["ms_a_frame"], figures["ms_a_pair"]) == (11.0, 28.0)  # two frames and their registration


def test_shares_of_nothing_are_none() -> None:
    figures = Tally([1], [2], [True], [10, 12], [5]).figures()
    assert figures["right_of_believed"] == 1.0
    assert figures["doubted_of_not_right"] is None  # every pose was right


def test_keypoints_are_lifted_by_depth() -> None:
    # White blobs on black at 2 m, the left half without depth: keypoints of the right half alone, at z = 2 where their pixel looks.
    camera = Camera(160, 120, 100.0, 100.0, 79.5, 59.5)
    colour, depth = np.zeros((120, 160, 3), np.float32), np.full((120, 160), 2.0, np.float32)
    rng = np.random.default_rng(0)
    for x, y in rng.integers(15, 105, (40, 2)):
        colour[y : y + 6, x + 20 : x + 27] = rng.random()
    depth[:, :80] = 0
    detector = KeypointDetector("SIFT")
    found = detector.detect(Frame(0, 0.0, colour, depth, camera))
    assert len(found.uv) > 10
    assert found.uv[:, 0].min() >= 79
    np.testing.assert_allclose(found.points[:, 0], (found.uv[:, 0] - 79.5) / 100 * 2, atol=1e-5)
    indices, weight = detector.match(found, found, 10)
    assert (indices[:, 0] == indices[:, 1]).all()  # an image matched with itself
    assert len(weight) == 10
    assert (np.diff(weight) <= 0).all()


def test_a_black_image_has_no_keypoints() -> None:
    blank = Frame.blank(0, 0.0, Camera(64, 48, 50.0, 50.0, 31.5, 23.5))
    for kind in ("SIFT", "ORB"):
        detector = KeypointDetector(kind)
        assert len(detector.match(detector.detect(blank), detector.detect(blank), 10)[0]) == 0


def test_every_method_finds_small_motions(box_recording: Path) -> None:
    # Two frames apart: 3 degrees and some 3 cm; on walls as smooth as these ORB finds no corners, and says so.
    recording = open_recording(box_recording)
    images = torch.from_numpy(recording[0].colour).permute(2, 0, 1)[None]
    keyframe, frame, truth = next(iter(sample(recording, 2, 1)))
    config = replace(TrackerConfig(), min_inliers=10)
    chosen = learned(config, ()) | baselines(config, images, lambda line: None)
    assert list(chosen) == ["ours", "untrained", "SIFT", "ORB"] + ["ICP", "GICP"] * icp_installed()
    for name, method in chosen.items():
        estimate = method.register(method.describe(frame), method.describe(keyframe))
        rotation, translation = pose_error(estimate.T_kc, truth)
        assert estimate.believed == (name != "ORB"), name
        if estimate.believed:
            assert rotation < 1.5, name
            assert translation < 5, name


@pytest.mark.slow
def test_the_command(box_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--gap", "1", "3", "--pairs", "2", "--out", str(tmp_path / "out")]
    main(["bench-pairs", str(box_recording), *flags, "--json"])
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert {(row["recording"], row["gap"], row["pairs"]) for row in found["rows"]} == {("box", 1, 2), ("box", 3, 2)}
    assert next(row for row in found["rows"] if row["method"] == "ours")["rotation_below_5_deg"] == 1.0
    assert json.loads((tmp_path / "out" / "pairs.json").read_text())["rows"] == found["rows"]
    assert "| ours | 3 | 2 | 100 |" in (tmp_path / "out" / "pairs.md").read_text()
    assert (tmp_path / "out" / "matches-box-3.png").stat().st_size > 10_000
    main(["bench-pairs", str(box_recording), "--gap", "3", "--pairs", "1", "--no-baselines"])
    assert [line.split(" | ")[0] for line in capsys.readouterr().out.splitlines() if " | 3 | " in line] == ["| ours"]


def test_rows_for_icp_are_left_out_where_it_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(registration_methods, "icp_installed", lambda: False)
    chosen = baselines(TrackerConfig(), torch.rand(1, 3, 24, 32), said.append)
    assert "GICP" not in chosen
    assert said == [f"no rows for ICP and GICP: small_gicp is not installed: {pip_install('small_gicp')}"]


def test_wrong_input(box_recording: Path) -> None:
    with pytest.raises(ConfigError, match="at least 1 pair"):
        bench_pairs([str(box_recording)], FAST, pairs=0)
    with pytest.raises(RecordingError, match="has 14 frames, expected more than --gap 20"):
        bench_pairs([str(box_recording)], FAST, gaps=[20])
    recording = open_recording(box_recording)
    recording.ground_truth = None
    with pytest.raises(RecordingError, match="has no ground truth"):
        sample(recording, 1, 2)
