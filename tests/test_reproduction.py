"""The reproduction of the paper's tables: suites, rows that are kept, tables by hand, and the page."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import trimesh

from helpers.box_room import BOX
from idfslam.batch.executor import Executor
from idfslam.benchmark.reproduction import evaluate_row
from idfslam.benchmark.reproduction import rows as module
from idfslam.benchmark.reproduction.rows import check_rows, run_suite
from idfslam.benchmark.reproduction.suite import ABLATIONS, SMALL, Job, Suite, TableScene, full_suite, methods_of, small_suite
from idfslam.cli import command_line
from idfslam.config import PRESETS, preset
from idfslam.errors import ConfigError, ResultError
from idfslam.report.reproduction_page import reproduction_page, write_reproduction
from idfslam.report.reproduction_tables import markdown, tables_of
from idfslam.storage.ledger import Ledger

METHODS = list(PRESETS)


class FakeExecutor(Executor):
    """Writes what a run and its evaluation would have left. Runs whose folder is in `failing` end with an error."""

    def __init__(self) -> None:
        super().__init__(1)
        self.runs: list[str] = []
        self.failing: set[str] = set()
        self.after: Callable[[], None] = lambda: None

    def _attempt(self, module: str, arguments: tuple[str, ...]) -> tuple[str | None, str]:
        out = Path(arguments[arguments.index("--out") + 1] if "--out" in arguments else arguments[0])
        if module == "idfslam.cli":
            self.runs.append(out.name)
            if out.name in self.failing:
                return "loss 'sdf' is not finite", "here"
            out.mkdir(exist_ok=True)
            Ledger(out).record()
            metrics = {"frames": 80, "seconds": 40.0, "frames_per_second": 2.0, "keyframes": 7, "lost_frames": 1, "peak_memory_mb": 900.0}
            (out / "metrics.json").write_text(json.dumps(metrics | {"ms_per_frame": {}}))
            lines = ["index,timestamp,status,keyframe,ms,finetune_total", "0,0.0,ok,1,5.0,", "1,0.1,ok,0,5.0,0.25"]
            (out / "frames.csv").write_text("\n".join(lines) + "\n")
        else:
            mesh = {"accuracy": 0.02, "completion": 0.03, "completion_ratio": 0.9}
            (out / "evaluation.json").write_text(json.dumps({"ate_m": {"rmse": 0.012, "mean": 0.01, "median": 0.009}, "mesh": mesh}))
            self.after()
        return None, "here"


def suite_of(*methods: str) -> Suite:
    scene = TableScene("room", "synthetic:0", "reconstruction", frames=80)
    return Suite(tuple(Job(scene, method) for method in methods), True, ("a note",))


def test_small_suite_has_embedded_recordings_alone() -> None:
    suite = small_suite(METHODS, ablations=True)
    assert all(job.scene.path.startswith("synthetic:") for job in suite.jobs)
    assert len(suite.jobs) == 2 * len(METHODS) + len(ABLATIONS)
    assert len({job.name for job in suite.jobs}) == len(suite.jobs)
    for job in suite.jobs:
        assert job.config(0, "cpu").mesh.resolution == 0.04  # it fits together, and all meshes have the same cells
    full = next(job for job in suite.jobs if job.variant == "full")
    assert (full.scene.frames, full.scene.stride) == (75, 8)  # a whole tour of 600 frames
    without = next(job for job in suite.jobs if job.variant == "no replay").config(0, "cpu")
    assert (without.keyframes.replay, full.config(0, "cpu").keyframes.replay) == (0, 10)
    assert set(SMALL) >= {"paper"}


def test_full_suite_takes_the_paper_s_sequences_where_they_are(tmp_path: Path) -> None:
    suite = full_suite(tmp_path, ["paper"], ablations=False)
    assert [job.scene.path for job in suite.jobs] == [f"synthetic:{i}" for i in range(3)] + [f"synthetic:{i}:kinect" for i in range(3)]
    assert len(suite.notes) == 2
    (tmp_path / "Replica/room0").mkdir(parents=True)
    (tmp_path / "Replica/room0/traj.txt").touch()
    (tmp_path / "Replica/room0_mesh.ply").touch()
    (tmp_path / "scannet/scene0059_00").mkdir(parents=True)
    suite = full_suite(tmp_path, ["paper"], ablations=True)
    assert [job.scene.name for job in suite.jobs[:2]] == ["room0", "scene0059_00"]
    assert suite.jobs[0].scene.gt_mesh == tmp_path / "Replica/room0_mesh.ply"
    assert len(suite.jobs) == 2 + len(ABLATIONS)
    assert suite.notes == ()
    assert suite.jobs[0].config(0, "auto") == preset("paper")  # unchanged


def test_methods() -> None:
    assert methods_of(None) == [name for name in ("imap", "nice", "paper", "fast") if name in PRESETS]
    assert methods_of(["fast", "paper"]) == ["paper", "fast"]
    with pytest.raises(ConfigError, match="--methods orb: no such preset, expected some of fast"):
        methods_of(["orb"])
    with pytest.raises(ConfigError, match="--methods: expected some of fast, paper, imap, nice behind it"):
        methods_of(())


def test_finished_rows_are_kept(tmp_path: Path) -> None:
    executor, folder = FakeExecutor(), tmp_path / "out"
    executor.failing = {"room-fast"}
    found = run_suite(suite_of("paper", "fast"), folder, executor)
    assert executor.runs == ["room-paper", "room-fast"]
    first, second = found["rows"]
    assert (first["ate_rmse_cm"], first["accuracy_cm"], first["completion_ratio_percent"]) == pytest.approx((1.2, 2.0, 90.0))
    assert (first["finetuning_steps"], first["keyframes"], first["processed"]) == (1, 7, 80)
    assert second["failed"] == "loss 'sdf' is not finite"
    with pytest.raises(ResultError, match=r"1 of 2 runs failed \(room-fast: loss 'sdf' is not finite\)"):
        check_rows(found, suite_of("paper", "fast"), folder)
    executor.failing = set()
    again = run_suite(suite_of("paper", "fast"), folder, executor)
    assert executor.runs == ["room-paper", "room-fast", "room-fast"]  # what failed is tried again, what finished is kept
    assert again["rows"][0] == first
    check_rows(again, suite_of("paper", "fast"), folder)
    run_suite(suite_of("paper", "fast"), folder, executor, seed=1)  # other values: other rows
    assert executor.runs[3:] == ["room-paper", "room-fast"]
    run_suite(suite_of("paper", "fast"), folder, executor, seed=1, overwrite=True)
    assert executor.runs[5:] == ["room-paper", "room-fast"]


def test_an_interrupted_call_keeps_its_rows(tmp_path: Path) -> None:
    executor, folder = FakeExecutor(), tmp_path / "out"
    executor.after = executor.stop  # as if Ctrl-C came during the first evaluation
    found = run_suite(suite_of("paper", "fast"), folder, executor)
    assert [row["name"] for row in found["rows"]] == ["room-paper"]
    with pytest.raises(KeyboardInterrupt):
        check_rows(found, suite_of("paper", "fast"), folder)
    executor = FakeExecutor()
    run_suite(suite_of("paper", "fast"), folder, executor)
    assert executor.runs == ["room-fast"]


def test_damaged_rows_are_told(tmp_path: Path) -> None:
    executor, folder = FakeExecutor(), tmp_path / "out"
    run_suite(suite_of("paper"), folder, executor)
    found = json.loads((folder / "reproduce.json").read_text())
    (folder / "reproduce.json").write_text("[]")
    with pytest.raises(ResultError, match=r"reproduce.json: "):
        run_suite(suite_of("paper"), folder, executor)
    assert module.REPORT == "reproduce.json"
    assert found["rows"][0]["method"] == "paper"


def row_of(method: str, scene: str, **changes: Any) -> dict[str, Any]:
    row = {"name": f"{scene}-{method}", "scene": scene, "table": "reconstruction", "sequence": None, "path": "synthetic:0", "frames": 80}
    row |= {"stride": 1, "gt_mesh": None, "method": method, "variant": "", "ate_rmse_cm": 1.0, "ate_mean_cm": 0.9, "ate_median_cm": 0.8}
    row |= {"accuracy_cm": 2.0, "completion_cm": 3.0, "completion_ratio_percent": 90.0, "processed": 80, "seconds": 40.0}
    return row | {"frames_per_second": 2.0, "peak_memory_mb": 900.0, "keyframes": 7, "lost_frames": 0, "finetuning_steps": 3} | changes


def results_of(*rows: dict[str, Any]) -> dict[str, Any]:
    machine = {"idf-slam": "1.0", "processor": "A processor", "cores": 2, "gpu": None}
    values = {"machine": machine, "protocol": "nice", "workers": 2, "small": True, "notes": ["a note"], "seed": 0}
    return values | {"printed": module._printed(), "rows": list(rows)}


def cells(table: dict[str, Any], first: str, second: str | None = None) -> list[str]:
    """The texts of the row that begins so."""
    texts = [[cell["text"] for cell in row["cells"]] for row in table["rows"]]
    return next(row for row in texts if row[0] == first and (second is None or row[1] == second))


def test_tables_by_hand() -> None:
    rows = [row_of("paper", "a"), row_of("paper", "b", accuracy_cm=4.0), row_of("fast", "a", accuracy_cm=1.0)]
    parts = [
        row_of("paper", "tour", table="ablation", variant=name, ate_rmse_cm=error) for name, error in (("full", 1.5), ("no replay", 2.5))
    ]
    first, second, cost, ablation = tables_of(results_of(*rows, *parts))
    assert first["titles"] == ["method", "metric", "a", "b", "mean"]
    assert cells(first, "paper", "Acc. [cm]") == ["paper", "Acc. [cm]", "2.00", "4.00", "3.00"]
    assert cells(first, "fast", "Acc. [cm]") == ["fast", "Acc. [cm]", "1.00", "-", "1.00"]
    # generated rooms are no columns of the paper: its means alone are shown
    assert cells(first, "iDF-SLAM, printed", "Acc. [cm]") == ["iDF-SLAM, printed", "Acc. [cm]", "-", "-", "4.86"]
    assert cells(second, "NICE-SLAM, printed", "ATE RMSE [cm]")[-1] == "1.96"
    best = [row["cells"][2]["best"] for row in first["rows"] if row["cells"][1]["text"] == "Acc. [cm]" and not row["printed"]]
    assert best == [False, True]
    assert cells(cost, "paper") == ["paper", "2.00", "0.28", "900", "-", "0 of 160", "7.0"]  # 2000 frames / 2 a second / 3600
    assert cells(ablation, "no replay")[:2] == ["no replay", "2.50"]
    assert ablation["titles"][-4:] == ["keyframes", "finetuning steps", "lost", "seconds"]


def test_printed_figures_stand_in_the_columns_of_their_sequences() -> None:
    (table, *_) = tables_of(results_of(row_of("paper", "room0", sequence="replica/room0")))
    assert cells(table, "iDF-SLAM, printed", "Comp. [cm]")[2] == "1.39"
    assert not any(cell["best"] for row in table["rows"] if row["printed"] for cell in row["cells"])


def test_page() -> None:
    failed = {"name": "room-nice", "scene": "room", "table": "reconstruction", "method": "nice", "failed": "out of memory"}
    results = results_of(row_of("paper", "room"), failed)
    tables = tables_of(results)
    page = reproduction_page(results, tables, total=3)
    assert "1 of 3 runs finished" in page
    assert page.count("<section") == 4  # Tables I and II, time, failures
    assert 'class="printed"' in page
    assert "room-nice: out of memory" in page
    assert "http" not in page.replace("https://arxiv.org/abs/2209.07919", "")  # nothing is loaded from elsewhere
    text = markdown(results, tables)
    assert "| paper | Acc. [cm] | 2.00 | 2.00 |" in text
    assert "| *iDF-SLAM, printed* | *Acc. [cm]* | *-* | *4.86* |" in text
    assert r"| *iMAP\*, printed* | *ATE RMSE [cm]* |" in text
    assert "Failed: room-nice: out of memory" in text


def test_a_real_run_is_measured_and_drawn(known_run: Path, box_recording: Path, tmp_path: Path) -> None:
    """Poses are the true ones, and the box is the true surface: the row has their errors, and the page both meshes."""
    folder, truth = tmp_path / "out", tmp_path / "box.ply"
    shutil.copytree(known_run, folder / "box-paper")
    trimesh.creation.box(2 * BOX).export(truth)
    evaluate_row.main([str(folder / "box-paper"), "--gt-mesh", str(truth)])
    row = module._measured(folder / "box-paper")
    assert row["ate_rmse_cm"] == pytest.approx(0, abs=1e-4)
    assert 0 < row["accuracy_cm"] < 10
    assert 0 < row["completion_ratio_percent"] <= 100
    assert (row["finetuning_steps"], row["processed"]) == (1, 14)
    base = row_of("paper", "box", path=str(box_recording), frames=None, gt_mesh=str(truth))
    results = results_of(base | row | {"name": "box-paper"})
    Ledger(folder).record()
    write_reproduction(folder, results, total=1)
    page = (folder / "reproduce.html").read_text()
    assert "<figcaption>truth</figcaption>" in page
    assert "<figcaption>paper</figcaption>" in page
    assert page.count("data:image/webp") == 2
    assert (folder / "reproduce.md").read_text().startswith("a note")


def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        command_line.main(["reproduce", "--data", "/nowhere"])
    assert capsys.readouterr().err.startswith("error: --data /nowhere: no such folder, expected one that holds Replica/")
    command = command_line.parse(["reproduce", "--small", "--methods", "paper", "fast", "--no-ablations", "--out", "there"])
    expected = command_line.Reproduce(small=True, methods=("paper", "fast"), ablations=False, out=Path("there"))
    assert command == expected
