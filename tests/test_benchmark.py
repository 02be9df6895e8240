"""The benchmark: its list, its arithmetic and tables by hand, and a small recording through it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import trimesh

from helpers.box_room import BOX, write_box_recording
from idfslam.batch.recordings import RecordingSpec, parse_recordings
from idfslam.benchmark import runs
from idfslam.benchmark.comparison import comparison
from idfslam.benchmark.runs import column_values, markdown, speed_kept, summary
from idfslam.benchmark.table import MeanStd
from idfslam.cli import command_line
from idfslam.config import FAST, PRETRAIN
from idfslam.errors import ConfigError, RecordingError
from idfslam.report.comparison_page import comparison_page


def run_of(seed: int, **changes: Any) -> dict[str, Any]:
    """A finished run as runs.json holds it."""
    run = {"seed": seed, "frames": 300, "frames_per_second": 10.0, "ate_m": 0.01, "lost_frames": 0.0, "ms_per_frame": {"map": 40.0}}
    return run | changes


def report_of(*runs: dict[str, Any], missing: str | None = None, **peers: list[dict[str, Any]]) -> dict[str, Any]:
    """The values of bench.json; missing: how to install a peer orbslam3 that is not there."""
    machine = {"idf-slam": "1.0", "processor": "A processor", "cores": 2, "gpu": None}
    absent = {} if missing is None else {"orbslam3": missing}
    found = {name: {"runs": of_peer} | summary(of_peer) for name, of_peer in (peers | {key: [] for key in absent}).items()}
    recording = {"name": "room", "path": "/room", "frames": None, "runs": list(runs), **summary(runs), "peers": found, "published": []}
    described = {name: {"about": f"what {name} is", "own_poses": True, "missing": absent.get(name)} for name in found}
    recordings = [recording | {"comparison": comparison(recording, absent, ["fusion"]) if found else None}]
    return {"machine": machine, "preset": "fast", "seeds": len(runs), "peers": described, "recordings": recordings}


def test_spread_by_hand() -> None:
    spread = MeanStd.of([1.0, 2.0, 6.0])  # mean 3, squared deviations 4 + 1 + 9 = 14, over 2: 7
    assert (spread.mean, spread.deviation, spread.count) == (3.0, pytest.approx(7**0.5), 3)
    assert spread.text(100, 1) == "300.0 ± 264.6"
    assert MeanStd.of([0.0123]).text(100) == "1.23"


def test_speed_kept_is_the_last_whole_hundred_over_the_second() -> None:
    assert speed_kept([5.0, 10.0, 9.0, 8.0, 1.0], 430) == pytest.approx(0.8)  # the last 30 frames are no whole hundred
    assert speed_kept([5.0, 10.0, 9.0], 300) == pytest.approx(0.9)
    assert speed_kept([5.0, 10.0, 9.0], 299) is None


def test_figures_of_a_run() -> None:
    metrics = {"frames": 14, "frames_per_second": 7.0, "frames_per_second_by_100": [7.0], "lost_frames": 1, "peak_memory_mb": None}
    assert column_values(metrics, None) == {"frames_per_second": 7.0, "lost_frames": 1.0}
    mesh = {"accuracy": 0.01, "completion": 0.02, "completion_ratio": 0.97, "protocol": "seen"}
    steps = {"rpe_1": {"rotation_deg": {"rmse": 0.4}}, "jump": {"rotation_deg": 2.5}, "doubtful_frames": 3}
    found = column_values(metrics | {"ate_m": {"rmse": 0.005}} | steps, mesh)
    assert (found["rpe_1_deg"], found["jump_deg"], found["doubtful_frames"]) == (0.4, 2.5, 3.0)
    assert (found["ate_m"], found["accuracy_m"], found["completion_m"], found["completion_ratio"]) == (0.005, 0.01, 0.02, 0.97)
    found = column_values(metrics, mesh | {"precision": 0.9, "recall": 0.7, "f1": 0.8, "normal_angle": 2.5})
    assert (found["precision"], found["f1"], found["normal_angle"]) == (0.9, 0.8, 2.5)


def test_table_by_hand() -> None:
    second = run_of(1, frames_per_second=14.0, ate_m=0.03, ms_per_frame={"map": 44.0})
    lines = markdown(report_of(run_of(0), second)).splitlines()
    assert lines[0].startswith("idf-slam 1.0, preset fast, A processor, 2 cores. Mean ± standard deviation")
    assert lines[2] == "| recording | frames | runs | ATE RMSE [cm] | frames/s | lost frames |"
    # means 2 cm and 12 frames/s; deviations sqrt(1 + 1) cm and sqrt(4 + 4) frames/s
    assert lines[4] == "| room | 300 | 2 of 2 | 2.00 ± 1.41 | 12.00 ± 2.83 | 0.0 ± 0.0 |"
    assert lines[8] == "| room | 42.0 ± 2.8 |"


def peer_run(seed: int, **changes: Any) -> dict[str, Any]:
    """A finished run of a peer."""
    return {"seed": seed, "frames": 300, "version": "2.0", "frames_per_second": 4.0, "ate_m": 0.04, "lost_frames": 3} | changes


def test_ratios_against_a_peer_by_hand() -> None:
    text = markdown(report_of(run_of(0), open3d=[peer_run(0)]))
    # ours has 1 cm and 10 frames/s: the best of both columns
    assert "| idf-slam | 1 of 1 | **1.00** | **10.00** | 0.0 | 1.00 | 1.00 |" in text
    assert "| open3d | 1 of 1 | 4.00 | 4.00 | 3.0 | 4.00 | 0.40 |" in text
    assert "open3d: what open3d is." in text
    without_truth = {key: value for key, value in peer_run(0).items() if key != "ate_m"}
    assert "| open3d | 1 of 1 | - | 4.00 | 3.0 | - | 0.40 |" in markdown(report_of(run_of(0), open3d=[without_truth]))


def test_who_loses_many_frames_is_not_ahead() -> None:
    fast = peer_run(0, ate_m=0.02, frames_per_second=20.0)
    report = report_of(run_of(0), open3d=[peer_run(0, ate_m=0.001, lost_frames=16)], rtabmap=[fast])
    (recording,) = report["recordings"]
    assert recording["comparison"]["winners"] == {"ate_m": "idf-slam", "frames_per_second": "rtabmap"}
    assert "open3d: lost 5% of the frames; its errors are over the others" in markdown(report)
    report = report_of(run_of(0), open3d=[peer_run(0, ate_m=0.001, lost_frames=15)])  # 5 % exactly
    assert report["recordings"][0]["comparison"]["winners"]["ate_m"] == "open3d"


def test_who_takes_our_poses_is_judged_by_the_surface_alone() -> None:
    own = {"accuracy_m": 0.01, "completion_ratio": 0.9}
    fusion = peer_run(0, frames_per_second=90.0, accuracy_m=0.005, completion_ratio=0.8)
    winners = report_of(run_of(0, **own), fusion=[fusion], open3d=[peer_run(0)])["recordings"][0]["comparison"]["winners"]
    assert winners == {"ate_m": "idf-slam", "accuracy_m": "fusion", "completion_ratio": "idf-slam", "frames_per_second": "idf-slam"}


def test_a_peer_that_is_missing_or_fails_is_a_row() -> None:
    crash = {"seed": 1, "failed": "ended after 12 of 300 frames: killed by SIGSEGV"}
    text = markdown(report_of(run_of(0), run_of(1), open3d=[peer_run(0), crash], missing="not installed: pip install pyorbslam3"))
    assert "| open3d | 1 of 2 | 4.00 |" in text
    assert "open3d: 1 of 2 runs failed: ended after 12 of 300 frames: killed by SIGSEGV" in text
    assert "| orbslam3 | 0 of 0 | - | - | - | - | - |" in text
    assert "orbslam3: not run: not installed: pip install pyorbslam3" in text
    assert "Failed: room, open3d, seed 1: ended after 12" in text


def test_page_of_a_comparison() -> None:
    report = report_of(run_of(0), open3d=[peer_run(0)], missing="pip install pyorbslam3")
    published = {"method": "NICE-SLAM", "title": "ATE RMSE [cm]", "value": 2.7, "source": "a paper", "url": "https://a.b", "protocol": None}
    report["recordings"][0]["published"] = [published]
    page = comparison_page(report)
    assert page.count("<section") == 1
    assert page.count("<svg") == 1
    assert '<td class="best">1.00</td>' in page
    assert "4.00<small>4.00 times ours</small>" in page
    assert "orbslam3: not run: pip install pyorbslam3" in page
    assert '<a href="https://a.b">a paper</a>' in page
    tables = page.split('<div class="sheet published">')
    assert "NICE-SLAM" not in tables[0]  # beside our table, never in it
    assert "A processor, 2 cores" in page
    assert "http" not in page.replace("https://a.b", "")  # nothing is loaded from elsewhere


def test_a_failed_run_is_told_and_not_averaged() -> None:
    text = markdown(report_of(run_of(0), {"seed": 1, "failed": "loss 'sdf' is not finite"}))
    assert "| room | 300 | 1 of 2 | 1.00 | 10.00 | 0.0 |" in text
    assert "Failed: room, seed 1: loss 'sdf' is not finite\n" in text
    nothing = markdown(report_of({"seed": 0, "failed": "no depth"}))
    assert "| room | - | 0 of 1 |" in nothing


def test_list_of_recordings(tmp_path: Path) -> None:
    for name in ("a/room", "b/room", "at@5"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "a/room/gt_mesh.ply").touch()
    first, second, third, fourth = parse_recordings(
        [f"{tmp_path}/a/room@40", f"{tmp_path}/b/room", "synthetic:3:kinect@600", f"{tmp_path}/at@5"], frames=9
    )
    assert (first.name, first.frames, first.gt_mesh) == ("a-room", 40, tmp_path / "a/room/gt_mesh.ply")
    assert (second.name, second.frames, second.gt_mesh) == ("b-room", 9, None)
    assert third == RecordingSpec("synthetic-3-kinect", "synthetic:3:kinect", 600)
    assert (fourth.name, fourth.frames) == ("at@5", 9)  # a folder of that name


@pytest.mark.parametrize(
    ("recordings", "error"), [([], "no recordings"), (["synthetic:1", "synthetic:1"], "twice"), (["synthetic@0"], "1 frame")]
)
def test_lists_that_cannot_be_run(recordings: list[str], error: str) -> None:
    with pytest.raises(ConfigError, match=error):
        parse_recordings(recordings)


def test_missing_recording_ends_before_the_first_run(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="nowhere"):
        runs.bench(["synthetic", "nowhere"], FAST, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_flags() -> None:
    flags = "--seeds 2 --frames 9 --preset paper --against open3d fusion --out there --no-mesh --mapper.pixels 64"
    command = command_line.parse(["bench", "a", "b@5", *flags.split()])
    assert isinstance(command, command_line.Bench)
    assert (command.recordings, command.seeds, command.frames, command.against) == (("a", "b@5"), 2, 9, ("open3d", "fusion"))
    assert (command.out, command.mesh, command.values.preset, command.values.mapper.pixels) == (Path("there"), False, "paper", 64)
    flags = "--out w --steps 5 --validate c --resume"
    expected = command_line.Pretrain((Path("a"), Path("b")), replace(PRETRAIN, steps=5), Path("w"), validate=(Path("c"),), resume=True)
    assert command_line.parse(["pretrain", "a", "b", *flags.split()]) == expected
    assert command_line.parse(["bench-pairs", "a", "--gap", "5", "20", "--json"]) == command_line.BenchPairs(
        ("a",), FAST, (5, 20), json=True
    )


@pytest.mark.slow
def test_bench_of_a_small_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording, out = write_box_recording(tmp_path / "box"), tmp_path / "out"
    trimesh.creation.box(2 * BOX).export(recording / "gt_mesh.ply")
    flags = ["--seeds", "1", "--seed", "4", "--device", "cpu", "--mesh.resolution", "0.05", "--out", str(out)]
    command_line.main(["bench", f"{recording}@8", *flags])
    report = json.loads((out / "bench.json").read_text())
    (found,) = report["recordings"]
    assert [(run["seed"], run["frames"]) for run in found["runs"]] == [(4, 8)]
    mean = {key: spread["mean"] for key, spread in found["summary"].items()}
    evaluation = json.loads((out / "box-4" / "evaluation.json").read_text())
    assert mean["ate_m"] == pytest.approx(evaluation["ate_m"]["rmse"], abs=1e-6)  # the file rounds poses
    assert mean["accuracy_m"] == evaluation["mesh"]["accuracy"] < 0.05
    assert mean["lost_frames"] == 0
    assert mean["peak_memory_mb"] > mean["peak_memory_above_imports_mb"] >= 0  # eight small frames may stay below the imports' own peak
    assert "| box | 8 | 1 of 1 |" in capsys.readouterr().out
    assert (out / "bench.md").read_text() == markdown(report)


@pytest.mark.slow
def test_a_run_that_fails_ends_with_1_and_the_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("rgb", "depth"):
        (tmp_path / "empty" / name).mkdir(parents=True)
    with pytest.raises(SystemExit) as caught:
        command_line.main(["bench", str(tmp_path / "empty"), "--seeds", "1", "--out", str(tmp_path / "out")])
    assert caught.value.code == 1
    assert f"empty, seed 0: {tmp_path / 'empty'}: no numbered images" in capsys.readouterr().err
    assert f"Failed: empty, seed 0: {tmp_path / 'empty'}: no numbered images" in (tmp_path / "out/bench.md").read_text()
