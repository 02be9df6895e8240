"""The benchmark: each recording with each seed, mean and spread of all figures, as JSON and as a Markdown table.

Every run and every evaluation is a process of its own: peak memory is then that of one run, and none finds what another has in memory.
"""

import platform
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from json import loads
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
from idfslam.storage import atomic_files

REPORT, TABLE, VALUES = "bench.json", "bench.md", "values.yaml"
_BLOCK = 100  # frames over which metrics.json gives the course of the speed


@dataclass(frozen=True)
class Column:
    """One figure of a run: its name in the JSON, and its column."""

    key: str
    title: str
    unit: float = 1.0  # what the stored value is multiplied with in the table
    digits: int = 2


COLUMNS = (
    Column("ate_m", "ATE RMSE [cm]", 100),
    Column("accuracy_m", "accuracy [cm]", 100),
    Column("completion_m", "completion [cm]", 100),
    Column("completion_ratio", "ratio < 5 cm [%]", 100, 1),
    Column("frames_per_second", "frames/s"),
    Column("speed_kept", "speed kept"),
    Column("peak_memory_mb", "peak memory [MiB]", digits=0),
    Column("peak_memory_above_imports_mb", "above imports [MiB]", digits=0),
    Column("keyframes", "keyframes", digits=1),
    Column("lost_frames", "lost frames", digits=1),
)


@dataclass(frozen=True)
class MeanStd:
    """Mean and sample standard deviation; of one value there is no deviation."""

    mean: float
    deviation: float | None
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> "MeanStd":
        """Raises statistics.StatisticsError for no values."""
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
    report: Callable[[str], None] = lambda line: None,
    executor: Executor | None = None,
) -> dict[str, Any]:
    """Runs `recordings` (paths or names as of `open_recording`, each with `@FRAMES` if wanted), each with `seeds` seeds.

    Results go to FOLDER/NAME-SEED; FOLDER/bench.json and FOLDER/bench.md are written anew after each recording. `mesh`: the surface is
    evaluated where the true one is known. `against="open3d"`: its dense SLAM on the same frames, before the runs of each recording.
    A run that fails is told in the report and the others go on. `executor`: where the seeds of a recording run; None: here, one at a
    time, as speed should be measured. Returns what bench.json holds.
    Raises ConfigError and RecordingError before the first run where the list cannot be run.
    """
    if seeds < 1 or (frames is not None and frames < 1):
        raise ConfigError(f"--seeds {seeds} --frames {frames}, expected at least 1")
    entries = parse_recordings(recordings, frames)
    if against is not None:
        from idfslam.benchmark.open3d_baseline import require_open3d

        require_open3d()
    atomic_files.prepare(folder)
    (folder / VALUES).write_text(yaml.safe_dump(dump(config), sort_keys=False), encoding="utf-8")
    found: dict[str, Any] = {"machine": machine(), "preset": config.preset, "seeds": seeds, "recordings": []}
    with executor or LocalExecutor() as place:
        for entry in entries:
            baseline = _open3d(place, entry, folder, report) if against else None
            one = partial(_run, place, entry, folder=folder, mesh=mesh, report=report)
            runs = sorted(place.map_unordered(one, range(config.seed, config.seed + seeds)), key=itemgetter("seed"))
            found["recordings"].append({**asdict(entry), "runs": runs, **summary(runs), "open3d": baseline})
            atomic_files.write_json(folder / REPORT, found)
            with atomic_files.replacing(folder / TABLE) as part:
                part.write_text(markdown(found), encoding="utf-8")
    return found


def _run(executor: Executor, entry: RecordingSpec, seed: int, *, folder: Path, mesh: bool, report: Callable[[str], None]) -> dict[str, Any]:
    """One run and its evaluation: the figures, or why there are none."""
    out = folder / f"{entry.name}-{seed}"
    count = [] if entry.frames is None else ["--frames", str(entry.frames)]
    values = ["--config", str(folder / VALUES), "--seed", str(seed)]
    try:
        _process(executor, "idfslam.cli", "run", entry.path, "--out", str(out), *count, "--no-report", *values)
        metrics = loads((out / result_folder.METRICS).read_text(encoding="utf-8"))
        evaluation: dict[str, Any] = {}
        if mesh and "ate_m" in metrics:
            truth = [] if entry.gt_mesh is None else ["--gt-mesh", str(entry.gt_mesh)]
            _process(executor, "idfslam.cli", "eval", str(out), *truth)
            evaluation = loads((out / "evaluation.json").read_text(encoding="utf-8"))
    except BenchError as error:
        report(f"{entry.name}, seed {seed}: failed: {error}")
        return {"seed": seed, "failed": str(error)}
    run = {
        "seed": seed,
        **column_values(metrics, evaluation.get("mesh")),
        "frames": metrics["frames"],
        "ms_per_frame": metrics["ms_per_frame"],
    }
    ate = f", ATE {run['ate_m'] * 100:.2f} cm" if "ate_m" in run else ""
    report(f"{entry.name}, seed {seed}: {run['frames']} frames, {run['frames_per_second']:.2f} frames/s{ate}")
    return run


def _open3d(executor: Executor, entry: RecordingSpec, folder: Path, report: Callable[[str], None]) -> dict[str, Any]:
    out = folder / f"{entry.name}-open3d.json"
    count = [] if entry.frames is None else ["--frames", str(entry.frames)]
    try:
        _process(executor, "idfslam.benchmark.open3d_baseline", entry.path, "--out", str(out), *count)
    except BenchError as error:
        report(f"{entry.name}, Open3D: failed: {error}")
        return {"failed": str(error)}
    found: dict[str, Any] = loads(out.read_text(encoding="utf-8"))
    ate = f", ATE {found['ate_m'] * 100:.2f} cm" if "ate_m" in found else ""
    report(f"{entry.name}, Open3D: {found['frames']} frames, {found['frames_per_second']:.2f} frames/s{ate}")
    return found


class BenchError(IdfSlamError):
    """A process of the benchmark that ended with an error; the message is its last line."""


def _process(executor: Executor, module: str, *arguments: str) -> None:
    done = executor.run_module(module, *arguments)
    if done.error is not None:
        raise BenchError(done.error)


def column_values(metrics: Mapping[str, Any], mesh: Mapping[str, Any] | None) -> dict[str, float]:
    """The values of COLUMNS that a run has, from its metrics.json and the mesh part of its evaluation.json."""
    found = {f.key: metrics.get(f.key) for f in COLUMNS} | {
        "speed_kept": speed_kept(metrics["frames_per_second_by_100"], metrics["frames"])
    }
    found["ate_m"] = metrics["ate_m"]["rmse"] if "ate_m" in metrics else None
    if mesh is not None:
        found |= {"accuracy_m": mesh["accuracy"], "completion_m": mesh["completion"], "completion_ratio": mesh["completion_ratio"]}
    return {key: float(value) for key, value in found.items() if value is not None}


def speed_kept(speeds: Sequence[float], frames: int) -> float | None:
    """Frames/s of the last whole hundred over that of frames 100 to 199, after all start-up; None for fewer than 300 frames."""
    whole = frames // _BLOCK
    return speeds[whole - 1] / speeds[1] if whole >= 3 else None


def summary(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Mean and deviation over the finished runs, of each figure and of each stage [ms a frame]."""
    finished = [run for run in runs if "failed" not in run]
    keys = [f.key for f in COLUMNS if any(f.key in run for run in finished)]
    stages = dict.fromkeys(stage for run in finished for stage in run["ms_per_frame"])
    return {
        "summary": {key: asdict(MeanStd.of([run[key] for run in finished if key in run])) for key in keys},
        "ms_per_frame": {stage: asdict(MeanStd.of([run["ms_per_frame"].get(stage, 0.0) for run in finished])) for stage in stages},
    }


def markdown(found: Mapping[str, Any]) -> str:
    """The report as text: figures, stages, the comparison with Open3D, and the runs that failed."""
    recordings = found["recordings"]
    m = found["machine"]
    used = [f for f in COLUMNS if any(f.key in r["summary"] for r in recordings)]
    head = (
        f"idf-slam {m['idf-slam']}, preset {found['preset']}, {m['processor']}, {m['cores']} cores{', ' + m['gpu'] if m['gpu'] else ''}. "
    )
    parts = [head + "Mean ± standard deviation over the seeds; surface by the protocol `seen`."]
    rows = [[r["name"], *_counts(r), *(_cell(r["summary"].get(f.key), f.unit, f.digits) for f in used)] for r in recordings]
    parts.append(markdown_table(["recording", "frames", "runs", *(f.title for f in used)], rows))
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
    """A line for each run of a recording, ours or Open3D's, that did not end well."""
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
    """Rows of cells below their titles, the first column to the left, the others to the right."""
    lines = [titles, ["---", *["---:"] * (len(titles) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def machine() -> dict[str, Any]:
    """What the figures were taken on."""
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


def check_finished(found: Mapping[str, Any], folder: Path) -> None:
    """Raises ResultError if a run failed, so that a script notices."""
    failed = [line for recording in found["recordings"] for line in failures(recording)]
    if failed:
        raise ResultError(f"{len(failed)} runs failed ({failed[0]}); {folder / TABLE} holds the others")
