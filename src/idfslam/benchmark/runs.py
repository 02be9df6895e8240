"""The benchmark: runs each recording with several seeds and reports mean and standard deviation, as JSON and as a Markdown table.

Each run and each evaluation is a process of its own, so that peak memory is that of one run and no run finds data of another in memory.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from operator import itemgetter
from pathlib import Path
from typing import Any

from idfslam.batch.executor import Executor
from idfslam.batch.local_executor import LocalExecutor
from idfslam.batch.recordings import RecordingSpec, parse_recordings
from idfslam.benchmark.comparison import comparison, comparison_markdown
from idfslam.benchmark.machine import machine
from idfslam.benchmark.peer_runs import PeerRuns
from idfslam.benchmark.processes import BenchError, frames_flag, run_module
from idfslam.benchmark.published import published_for
from idfslam.benchmark.table import SURFACE, Column, MeanStd, markdown_table
from idfslam.config import Config, as_yaml
from idfslam.errors import ConfigError, ResultError
from idfslam.runs import result_folder
from idfslam.runs.meter import BLOCK
from idfslam.runs.metrics import ate_rmse, headline, read_metrics
from idfslam.runs.run_folder import open_for_runs
from idfslam.storage.json_file import read_json

REPORT, TABLE, VALUES, PAGE = "bench.json", "bench.md", "values.yaml", "bench.html"
COLUMNS = (
    Column("ate_m", "ATE RMSE [cm]", 100),
    Column("rpe_1_deg", "RPE over one frame [deg]"),
    Column("jump_deg", "largest jump [deg]"),
    *SURFACE,
    Column("frames_per_second", "frames/s"),
    Column("speed_kept", "speed kept"),
    Column("peak_memory_mb", "peak memory [MiB]", digits=0),
    Column("peak_memory_above_imports_mb", "above imports [MiB]", digits=0),
    Column("keyframes", "keyframes", digits=1),
    Column("lost_frames", "lost frames", digits=1),
    Column("doubtful_frames", "doubtful frames", digits=1),
)


def bench(
    recordings: Sequence[str],
    config: Config,
    folder: Path,
    *,
    seeds: int = 3,
    frames: int | None = None,
    mesh: bool = True,
    against: Sequence[str] = (),
    overwrite: bool = False,
    report: Callable[[str], None] = lambda line: None,
    executor: Executor | None = None,
) -> dict[str, Any]:
    """Runs each of `recordings` (as `parse_recordings` takes them) with the seeds config.seed, config.seed + 1, ...

    Results go to FOLDER/NAME-SEED. FOLDER/bench.json and FOLDER/bench.md are rewritten after each recording. frames: of each recording;
    None: all. mesh: evaluate the surface if the true one is known. against: peers that run on the same frames after each seed, as
    NAME or as NAME=PYTHON of the environment that has it. overwrite: earlier results in `folder` are replaced.
    report: receives a line after each run. executor: where the seeds run; None: on this machine, one at a time, which is the only way to
    measure speed. If a run fails, the report says why and the others continue. Returns the values of bench.json.

    Raises ConfigError or RecordingError, before the first run, for recordings or values that cannot be run, and ResultError for a folder
    that cannot be written to, is in use, holds anything but results, or holds results that are not to be replaced.
    """
    if seeds < 1 or (frames is not None and frames < 1):
        raise ConfigError(f"--seeds {seeds}{'' if frames is None else f' --frames {frames}'}, expected at least 1")
    specs, peers = parse_recordings(recordings, frames), PeerRuns(against)
    if peers.borrowing and not mesh:
        raise ConfigError(f"--against {peers.borrowing[0]} with --no-mesh: only its surface is its own, leave one of the two out")
    results: dict[str, Any] = {"machine": machine(), "preset": config.preset, "seeds": seeds, "peers": peers.described(), "recordings": []}
    chosen = range(config.seed, config.seed + seeds)
    names = [name for spec in specs for seed in chosen for name in (f"{spec.name}-{seed}", *peers.folders(spec, seed))]
    with open_for_runs(folder, names, [VALUES, REPORT, TABLE, PAGE], overwrite=overwrite) as ledger, executor or LocalExecutor() as opened:
        ledger.write_text(VALUES, as_yaml(config))
        for spec in specs:

            def run_seed(seed: int, spec: RecordingSpec = spec) -> dict[str, Any]:
                run = _run(opened, spec, seed, folder=folder, mesh=mesh, report=report)
                return run | {"peers": peers.run(opened, spec, seed, folder=folder, mesh=mesh, report=report)}

            runs = sorted(opened.map_unordered(run_seed, chosen), key=itemgetter("seed"))
            results["recordings"].append({**asdict(spec), **_summaries(runs, peers), "published": published_for(spec.path)})
            ledger.write_json(REPORT, results)
            ledger.write_text(TABLE, markdown(results))
    return results


def _summaries(runs: Sequence[dict[str, Any]], peers: PeerRuns) -> dict[str, Any]:
    """The runs of a recording with their means, ours and those of each peer, and how they compare."""
    of_peers = {name: [run["peers"][name] for run in runs if name in run["peers"]] for name in peers.names}
    ours = [{key: value for key, value in run.items() if key != "peers"} for run in runs]
    values = {"runs": ours, **summary(ours), "peers": {name: {"runs": found} | summary(found) for name, found in of_peers.items()}}
    return values | {"comparison": comparison(values, peers.missing, peers.borrowing) if peers.names else None}


def _run(executor: Executor, spec: RecordingSpec, seed: int, *, folder: Path, mesh: bool, report: Callable[[str], None]) -> dict[str, Any]:
    """One run and its evaluation: the measured values, or the reason of the failure."""
    out = folder / f"{spec.name}-{seed}"
    values = ["--config", str(folder / VALUES), "--seed", str(seed)]
    try:
        run_module(executor, "idfslam.cli", "run", spec.path, "--out", str(out), "--overwrite", *frames_flag(spec), "--no-report", *values)
        metrics = read_metrics(out)
        evaluation: dict[str, Any] = {}
        if mesh and ate_rmse(metrics) is not None:
            truth = [] if spec.gt_mesh is None else ["--gt-mesh", str(spec.gt_mesh)]
            run_module(executor, "idfslam.cli", "eval", str(out), *truth)
            evaluation = read_json(out / result_folder.EVALUATION, error=BenchError, expected="the evaluation of a run")
    except BenchError as error:
        report(f"{spec.name}, seed {seed}: failed: {error}")
        return {"seed": seed, "failed": str(error)}
    measured = column_values(metrics, evaluation.get("mesh"))
    report(f"{spec.name}, seed {seed}: {headline(metrics['frames'], metrics['frames_per_second'], ate_rmse(metrics))}")
    return {"seed": seed, **measured, "frames": metrics["frames"], "ms_per_frame": metrics["ms_per_frame"]}


def column_values(metrics: Mapping[str, Any], mesh: Mapping[str, Any] | None) -> dict[str, float]:
    """The values of COLUMNS that a run has, from its metrics.json and the mesh part of its evaluation.json."""
    values = {column.key: metrics.get(column.key) for column in COLUMNS}
    values |= {"speed_kept": speed_kept(metrics["frames_per_second_by_100"], metrics["frames"]), "ate_m": ate_rmse(metrics)}
    if "jump" in metrics:
        values |= {"rpe_1_deg": metrics["rpe_1"]["rotation_deg"]["rmse"], "jump_deg": metrics["jump"]["rotation_deg"]}
    if mesh is not None:
        values |= {"accuracy_m": mesh["accuracy"], "completion_m": mesh["completion"], "completion_ratio": mesh["completion_ratio"]}
        values |= {key: mesh.get(key) for key in ("precision", "f1", "normal_angle")}
    return {key: float(value) for key, value in values.items() if value is not None}


def speed_kept(speeds: Sequence[float], frames: int) -> float | None:
    """Speed of the last whole block of 100 frames, divided by that of frames 100 to 199 (after all start-up); None below 300 frames."""
    whole = frames // BLOCK
    return speeds[whole - 1] / speeds[1] if whole >= 3 else None


def summary(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Mean and standard deviation over the finished runs, of each column and of each stage [ms per frame]."""
    finished = [run for run in runs if "failed" not in run]
    keys = [column.key for column in COLUMNS if any(column.key in run for run in finished)]
    stages = dict.fromkeys(stage for run in finished for stage in run.get("ms_per_frame", {}))
    return {
        "summary": {key: asdict(MeanStd.of([run[key] for run in finished if key in run])) for key in keys},
        "ms_per_frame": {stage: asdict(MeanStd.of([run["ms_per_frame"].get(stage, 0.0) for run in finished])) for stage in stages},
    }


def markdown(results: Mapping[str, Any]) -> str:
    """The report as text: measured values, stages, the comparison with the peers, and the runs that failed."""
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
    if results["peers"]:
        parts.append(comparison_markdown(results))
    parts += [f"Failed: {line}" for r in recordings for line in failures(r)]
    return "\n\n".join(parts) + "\n"


def failures(recording: Mapping[str, Any]) -> list[str]:
    """A line for each failed run of a recording, ours or a peer's."""
    runs = [(f"seed {run['seed']}", run) for run in recording["runs"]]
    runs += [(f"{name}, seed {run['seed']}", run) for name, peer in recording["peers"].items() for run in peer["runs"]]
    return [f"{recording['name']}, {which}: {run['failed']}" for which, run in runs if "failed" in run]


def _counts(recording: Mapping[str, Any]) -> tuple[str, str]:
    finished = [run for run in recording["runs"] if "failed" not in run]
    return str(finished[0]["frames"]) if finished else "-", f"{len(finished)} of {len(recording['runs'])}"


def _cell(spread: Mapping[str, Any] | None, unit: float, digits: int) -> str:
    return "-" if spread is None else MeanStd(**spread).text(unit, digits)


def check_finished(results: Mapping[str, Any], folder: Path) -> None:
    """Raises ResultError if one of our own runs failed, so that the exit status shows it. What a peer does is part of the results."""
    failed = [f"{r['name']}, seed {run['seed']}: {run['failed']}" for r in results["recordings"] for run in r["runs"] if "failed" in run]
    if failed:
        raise ResultError(f"{len(failed)} runs failed ({failed[0]}); {folder / TABLE} holds the others")
