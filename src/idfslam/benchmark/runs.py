"""The benchmark: runs each recording with several seeds and reports mean and standard deviation, as JSON and as a Markdown table.

Each run and each evaluation is a process of its own, so that peak memory is that of one run and no run finds data of another in memory.
"""

import platform
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import yaml

from idfslam import __version__
from idfslam.batch.executor import Executor
from idfslam.batch.local_executor import LocalExecutor
from idfslam.batch.recordings import RecordingSpec, parse_recordings
from idfslam.compute.host import cores, processor
from idfslam.config import Config, dump
from idfslam.errors import ConfigError, IdfSlamError, ResultError
from idfslam.runs import result_folder
from idfslam.runs.meter import BLOCK
from idfslam.runs.metrics import ate_rmse, headline, read_metrics
from idfslam.runs.run_folder import open_for_runs
from idfslam.storage import atomic_files
from idfslam.storage.json_file import read_json

REPORT, TABLE, VALUES = "bench.json", "bench.md", "values.yaml"


@dataclass(frozen=True)
class Column:
    """A measured value of a run: its name in the JSON, and its column in the table."""

    key: str
    title: str
    unit: float = 1.0  # factor from the stored value to the table's
    digits: int = 2


COLUMNS = (
    Column("ate_m", "ATE RMSE [cm]", 100),
    Column("rpe_1_deg", "RPE over one frame [deg]"),
    Column("jump_deg", "largest jump [deg]"),
    Column("accuracy_m", "accuracy [cm]", 100),
    Column("completion_m", "completion [cm]", 100),
    Column("completion_ratio", "ratio < 5 cm [%]", 100, 1),
    Column("frames_per_second", "frames/s"),
    Column("speed_kept", "speed kept"),
    Column("peak_memory_mb", "peak memory [MiB]", digits=0),
    Column("peak_memory_above_imports_mb", "above imports [MiB]", digits=0),
    Column("keyframes", "keyframes", digits=1),
    Column("lost_frames", "lost frames", digits=1),
    Column("doubtful_frames", "doubtful frames", digits=1),
)


@dataclass(frozen=True)
class MeanStd:
    """Mean and sample standard deviation of `count` values; a single value has no deviation."""

    mean: float
    deviation: float | None
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> "MeanStd":
        """Of at least one value. Raises statistics.StatisticsError for none."""
        return cls(statistics.fmean(values), statistics.stdev(values) if len(values) > 1 else None, len(values))

    def text(self, unit: float = 1.0, digits: int = 2) -> str:
        """`mean ± deviation`."""
        mean = f"{self.mean * unit:.{digits}f}"
        return mean if self.deviation is None else f"{mean} ± {self.deviation * unit:.{digits}f}"


def bench(
    recordings: Sequence[str],
    config: Config,
    folder: Path,
    *,
    seeds: int = 3,
    frames: int | None = None,
    mesh: bool = True,
    against: str | None = None,
    overwrite: bool = False,
    report: Callable[[str], None] = lambda line: None,
    executor: Executor | None = None,
) -> dict[str, Any]:
    """Runs each of `recordings` (as `parse_recordings` takes them) with the seeds config.seed, config.seed + 1, ...

    Results go to FOLDER/NAME-SEED. FOLDER/bench.json and FOLDER/bench.md are rewritten after each recording. frames: of each recording;
    None: all. mesh: evaluate the surface if the true one is known. against: "open3d" also runs Open3D's dense SLAM on the same frames.
    overwrite: earlier results in `folder` are replaced. report: receives a line after each run. executor: where the seeds run; None: on
    this machine, one at a time, which is the only way to measure speed. If a run fails, the report says why and the others continue.
    Returns the values of bench.json.
    Raises ConfigError or RecordingError, before the first run, for recordings or values that cannot be run, and ResultError for a folder
    that cannot be written to, is in use, holds anything but results, or holds results that are not to be replaced.
    """
    if seeds < 1 or (frames is not None and frames < 1):
        raise ConfigError(f"--seeds {seeds}{'' if frames is None else f' --frames {frames}'}, expected at least 1")
    specs = parse_recordings(recordings, frames)
    if against is not None:
        from idfslam.benchmark.open3d_baseline import require_open3d

        require_open3d()
    results: dict[str, Any] = {"machine": machine(), "preset": config.preset, "seeds": seeds, "recordings": []}
    names = [f"{spec.name}-{config.seed + i}" for spec in specs for i in range(seeds)]
    baselines = [_open3d_file(spec) for spec in specs] if against else []
    files = [VALUES, REPORT, TABLE, *baselines]
    with open_for_runs(folder, names, files, overwrite=overwrite) as ledger, executor or LocalExecutor() as opened:
        with ledger.replacing(VALUES) as part:
            part.write_text(yaml.safe_dump(dump(config), sort_keys=False), encoding="utf-8")
        for spec in specs:
            baseline = _run_open3d(opened, spec, folder, report) if against else None
            run_seed = partial(_run, opened, spec, folder=folder, mesh=mesh, report=report)
            runs = sorted(opened.map_unordered(run_seed, range(config.seed, config.seed + seeds)), key=itemgetter("seed"))
            results["recordings"].append({**asdict(spec), "runs": runs, **summary(runs), "open3d": baseline})
            with ledger.replacing(REPORT) as part:
                atomic_files.write_json(part, results)
            with ledger.replacing(TABLE) as part:
                part.write_text(markdown(results), encoding="utf-8")
            ledger.record([name for name in baselines if (folder / name).is_file()])
    return results


def _run(executor: Executor, spec: RecordingSpec, seed: int, *, folder: Path, mesh: bool, report: Callable[[str], None]) -> dict[str, Any]:
    """One run and its evaluation: the measured values, or the reason of the failure."""
    out = folder / f"{spec.name}-{seed}"
    values = ["--config", str(folder / VALUES), "--seed", str(seed), "--no-report", "--overwrite"]
    try:
        _run_module(
            executor, "idfslam.cli", "run", spec.path, "--out", str(out), "--overwrite", *_frames_flag(spec), "--no-report", *values
        )
        metrics = read_metrics(out)
        evaluation: dict[str, Any] = {}
        if mesh and ate_rmse(metrics) is not None:
            truth = [] if spec.gt_mesh is None else ["--gt-mesh", str(spec.gt_mesh)]
            _run_module(executor, "idfslam.cli", "eval", str(out), *truth)
            evaluation = read_json(out / result_folder.EVALUATION, error=BenchError, expected="the evaluation of a run")
    except BenchError as error:
        report(f"{spec.name}, seed {seed}: failed: {error}")
        return {"seed": seed, "failed": str(error)}
    measured = column_values(metrics, evaluation.get("mesh"))
    report(f"{spec.name}, seed {seed}: {headline(metrics['frames'], metrics['frames_per_second'], ate_rmse(metrics))}")
    return {"seed": seed, **measured, "frames": metrics["frames"], "ms_per_frame": metrics["ms_per_frame"]}


def _run_open3d(executor: Executor, spec: RecordingSpec, folder: Path, report: Callable[[str], None]) -> dict[str, Any]:
    out = folder / _open3d_file(spec)
    try:
        _run_module(executor, "idfslam.benchmark.open3d_baseline", spec.path, "--out", str(out), *_frames_flag(spec))
    except BenchError as error:
        report(f"{spec.name}, Open3D: failed: {error}")
        return {"failed": str(error)}
    measured: dict[str, Any] = read_json(out, error=BenchError, expected="the values of a run of Open3D")
    report(f"{spec.name}, Open3D: {headline(measured['frames'], measured['frames_per_second'], measured.get('ate_m'))}")
    return measured


def _open3d_file(spec: RecordingSpec) -> str:
    return f"{spec.name}-open3d.json"


def _frames_flag(spec: RecordingSpec) -> list[str]:
    return [] if spec.frames is None else ["--frames", str(spec.frames)]


class BenchError(IdfSlamError):
    """A process of the benchmark failed; the message is its last line."""


def _run_module(executor: Executor, module: str, *arguments: str) -> None:
    outcome = executor.run_module(module, *arguments)
    if outcome.error is not None:
        raise BenchError(outcome.error)


def column_values(metrics: Mapping[str, Any], mesh: Mapping[str, Any] | None) -> dict[str, float]:
    """The values of COLUMNS that a run has, from its metrics.json and the mesh part of its evaluation.json."""
    values = {column.key: metrics.get(column.key) for column in COLUMNS}
    values |= {"speed_kept": speed_kept(metrics["frames_per_second_by_100"], metrics["frames"]), "ate_m": ate_rmse(metrics)}
    if "jump" in metrics:
        values |= {"rpe_1_deg": metrics["rpe_1"]["rotation_deg"]["rmse"], "jump_deg": metrics["jump"]["rotation_deg"]}
    if mesh is not None:
        values |= {"accuracy_m": mesh["accuracy"], "completion_m": mesh["completion"], "completion_ratio": mesh["completion_ratio"]}
    return {key: float(value) for key, value in values.items() if value is not None}


def speed_kept(speeds: Sequence[float], frames: int) -> float | None:
    """Speed of the last whole block of 100 frames, divided by that of frames 100 to 199 (after all start-up); None below 300 frames."""
    whole = frames // BLOCK
    return speeds[whole - 1] / speeds[1] if whole >= 3 else None


def summary(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Mean and standard deviation over the finished runs, of each column and of each stage [ms per frame]."""
    finished = [run for run in runs if "failed" not in run]
    keys = [column.key for column in COLUMNS if any(column.key in run for run in finished)]
    stages = dict.fromkeys(stage for run in finished for stage in run["ms_per_frame"])
    return {
        "summary": {key: asdict(MeanStd.of([run[key] for run in finished if key in run])) for key in keys},
        "ms_per_frame": {stage: asdict(MeanStd.of([run["ms_per_frame"].get(stage, 0.0) for run in finished])) for stage in stages},
    }


def markdown(results: Mapping[str, Any]) -> str:
    """The report as text: measured values, stages, the comparison with Open3D, and the runs that failed."""
    recordings, m = results["recordings"], results["machine"]
    used = [column for column in COLUMNS if any(column.key in recording["summary"] for recording in recordings)]
    gpu = f", {m['gpu']}" if m["gpu"] else ""
    head = f"idf-slam {m['idf-slam']}, preset {results['preset']}, {m['processor']}, {m['cores']} cores{gpu}. "
    parts = [head + "Mean ± standard deviation over the seeds; surface by the protocol `seen`."]
    rows = [[r["name"], *_counts(r), *(_cell(r["summary"].get(c.key), c.unit, c.digits) for c in used)] for r in recordings]
    parts.append(markdown_table(["recording", "frames", "runs", *(column.title for column in used)], rows))
    stages = list(dict.fromkeys(stage for r in recordings for stage in r["ms_per_frame"]))
    if stages:
        rows = [[r["name"], *(_cell(r["ms_per_frame"].get(stage), 1.0, 1) for stage in stages)] for r in recordings]
        parts.append(markdown_table(["[ms a frame]", *stages], rows))
    compared = [r for r in recordings if r["open3d"] is not None and "failed" not in r["open3d"]]
    if compared:
        titles = ["recording", "Open3D frames/s", "ours", "times as fast", "Open3D ATE RMSE [cm]", "ours", "ours / Open3D's", "Open3D lost"]
        parts.append(markdown_table(titles, [_comparison(r) for r in compared]))
    parts += [f"Failed: {line}" for r in recordings for line in failures(r)]
    return "\n\n".join(parts) + "\n"


def failures(recording: Mapping[str, Any]) -> list[str]:
    """A line for each failed run of a recording, ours or Open3D's."""
    runs = [(f"seed {run['seed']}", run) for run in recording["runs"]] + [("Open3D", recording["open3d"] or {})]
    return [f"{recording['name']}, {which}: {run['failed']}" for which, run in runs if "failed" in run]


def _counts(recording: Mapping[str, Any]) -> tuple[str, str]:
    finished = [run for run in recording["runs"] if "failed" not in run]
    return str(finished[0]["frames"]) if finished else "-", f"{len(finished)} of {len(recording['runs'])}"


def _comparison(recording: Mapping[str, Any]) -> list[str]:
    theirs, ours = recording["open3d"], recording["summary"]
    cells = [recording["name"]]
    for key, unit in (("frames_per_second", 1.0), ("ate_m", 100.0)):
        a, b = theirs.get(key), ours.get(key)
        cells += ["-" if a is None else f"{a * unit:.2f}", _cell(b, unit, 2), f"{b['mean'] / a:.2f}" if a and b is not None else "-"]
    return [*cells, str(theirs["lost_frames"])]


def _cell(spread: Mapping[str, Any] | None, unit: float, digits: int) -> str:
    return "-" if spread is None else MeanStd(**spread).text(unit, digits)


def markdown_table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; the first column is aligned left, the others right."""
    lines = [titles, ["---", *["---:"] * (len(titles) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def machine() -> dict[str, Any]:
    """The machine and the versions of a measurement."""
    import torch

    return {
        "processor": processor(),
        "cores": cores(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "system": platform.platform(),
        "python": platform.python_version(),
        "idf-slam": __version__,
        "torch": torch.__version__,
    }


def check_finished(results: Mapping[str, Any], folder: Path) -> None:
    """Raises ResultError if a run failed, so that the exit status shows it."""
    failed = [line for recording in results["recordings"] for line in failures(recording)]
    if failed:
        raise ResultError(f"{len(failed)} runs failed ({failed[0]}); {folder / TABLE} holds the others")
