"""The command line: parses, then calls. What is heavy is imported inside the commands, so that --help is quick.

Threads: the numerical libraries use one thread a core, at most 8 (the networks are small), and idle threads sleep instead of spinning:
beside another job spinning costs most of the speed. OMP_NUM_THREADS, NUMBA_NUM_THREADS, OMP_WAIT_POLICY and GOMP_SPINCOUNT, where set,
win. OpenCV runs on one thread.
"""

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol

import tyro
from tyro.conf import DisallowNone, Positional, arg, subcommand

from idfslam import __version__
from idfslam.config import FAST, PRESETS, PRETRAIN, Config, PretrainConfig, check, load
from idfslam.errors import IdfSlamError

if TYPE_CHECKING:
    from rich.console import Console

_MOST_THREADS = 8
_INTERRUPTED = 130  # 128 + SIGINT, as shells have it

Values = Annotated[Config, arg(name="")]  # its fields are flags of their own: --seed, --mapper.pixels


class Command(Protocol):
    """A command with its flags."""

    def __call__(self, console: "Console") -> None: ...


@dataclass(frozen=True)
class CameraFlags:
    """The camera, where it is not the recording's own; the flags win over what the recording says."""

    fx: float | None = None
    """Focal length [px]."""
    fy: float | None = None
    """Focal length [px]."""
    cx: float | None = None
    """Principal point [px]; pixel centres at integers."""
    cy: float | None = None
    """Principal point [px]."""
    depth_scale: float | None = None
    """Units of the depth images per metre: 1000 for millimetres."""


@dataclass(frozen=True)
class Demo:
    """SLAM on a room that the package generates itself: run, evaluation and pictures, no files needed."""

    values: Values = FAST
    out: Path = Path("results/demo")
    """The result folder."""
    frames: int = 240
    """Frames of the walk through the room."""
    room: int = 0
    """Which room: any number makes one."""
    config: Path | None = None
    """A YAML file of values (a run's config.yaml, or a few lines of it); flags win over it."""

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        from idfslam.demo import demo
        from idfslam.tables import print_evaluation, print_files, print_run

        done, evaluation, pictures = demo(values, self.out, room=self.room, frames=self.frames, console=console)
        print_run(done, output())
        print_evaluation(evaluation, self.out, output())
        print_files(self.out, [path.name for path in pictures], output())


@dataclass(frozen=True)
class Run:
    """SLAM on a recording: trajectory, mesh, map and figures into a folder."""

    path: Positional[Path]
    """The recording, in any layout that is known; which one is seen from what lies in it."""
    values: Values = FAST
    out: Path | None = None
    """The result folder; none given: results/ and the recording's name."""
    start: int = 0
    """The first frame."""
    frames: int | None = None
    """How many frames; none given: to the end."""
    stride: int = 1
    """Every so many frames one is taken."""
    format: str | None = None
    """The recording's layout, where it is not to be seen from its files."""
    camera: CameraFlags = CameraFlags()
    config: Path | None = None
    """A YAML file of values (a run's config.yaml, or a few lines of it); flags win over it, and it over the preset."""

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        from idfslam.results import Source
        from idfslam.run import open_source, run
        from idfslam.tables import print_run

        camera = {key: value for key, value in asdict(self.camera).items() if value is not None}
        scale = camera.pop("depth_scale", None)
        place = self.path.absolute() if self.path.exists() else self.path  # found again from anywhere; `synthetic` is no file
        source = Source(str(place), self.format, camera or None, scale, self.start, self.frames, self.stride)
        recording = open_source(source)
        folder = self.out or Path("results") / recording.name
        print_run(run(recording, values, folder, source=source, console=console), output())


@dataclass(frozen=True)
class Eval:
    """Errors of a run's trajectory and mesh against ground truth: a table, evaluation.json and pictures."""

    folder: Positional[Path]
    """The result folder."""
    gt: Path | None = None
    """True trajectory in TUM format, camera-to-world; none given: the recording's own."""
    gt_mesh: Path | None = None
    """True mesh [m], in the frame of the true trajectory; none given: a synthetic room's own, else the mesh is not evaluated."""
    protocol: Literal["seen", "nice", "neural-rgbd", "coslam", "eslam"] = "seen"
    """What counts as surface."""

    def __call__(self, console: "Console") -> None:
        from idfslam.evaluate import evaluate_folder
        from idfslam.tables import print_evaluation

        evaluation = evaluate_folder(self.folder, gt=self.gt, gt_mesh=self.gt_mesh, protocol=self.protocol)
        print_evaluation(evaluation, self.folder, output())


@dataclass(frozen=True)
class Mesh:
    """The mesh of a saved map at another resolution."""

    folder: Positional[Path]
    """The result folder."""
    resolution: float = 0.02
    """Edge of the marching-cubes cells [m]."""
    out: Path | None = None
    """The mesh file (.ply, .obj, .glb, ...); none given: mesh.ply of the result folder."""

    def __call__(self, console: "Console") -> None:
        from idfslam.saved import write_mesh

        print(write_mesh(self.folder, self.out, resolution=self.resolution))


@dataclass(frozen=True)
class Render:
    """Colour and depth pictures of a saved map, seen from frames of the trajectory."""

    folder: Positional[Path]
    """The result folder."""
    frames: tuple[int, ...] = ()
    """Which frames; none given: the keyframes."""
    out: Path | None = None
    """Where the pictures go; none given: render/ in the result folder."""

    def __call__(self, console: "Console") -> None:
        from idfslam.saved import write_views

        print(*write_views(self.folder, self.out, frames=self.frames), sep="\n")


@dataclass(frozen=True)
class Bench:
    """SLAM on a list of recordings with several seeds each: mean and spread of errors, speed, memory and stage times."""

    recordings: Positional[tuple[str, ...]]
    """Recordings of any layout, or synthetic[:SEED][:kinect]; PATH@FRAMES: the first FRAMES. gt_mesh.ply in one is its true surface."""
    values: Values = FAST
    seeds: int = 3
    """How many seeds, from --seed on."""
    frames: int | None = None
    """How many frames of each; none given: all of a recording, one tour of a synthetic room."""
    against: Literal["open3d"] | None = None
    """A baseline on the same frames: Open3D's dense frame-to-model SLAM, on the CPU."""
    out: Path = Path("results/bench")
    """Where results, bench.json and bench.md go."""
    mesh: bool = True
    """Whether the surface is evaluated where the true one is known."""
    config: Path | None = None
    """A YAML file of values (a run's config.yaml, or a few lines of it); flags win over it, and it over the preset."""

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        from idfslam.bench import REPORT, TABLE, bench, check_finished
        from idfslam.tables import print_files

        options: dict[str, Any] = {"seeds": self.seeds, "frames": self.frames, "mesh": self.mesh, "against": self.against}
        report = partial(console.print, highlight=False, markup=False, soft_wrap=True)
        found = bench(self.recordings, values, self.out, **options, report=report)
        print((self.out / TABLE).read_text(encoding="utf-8"))
        print_files(self.out, (REPORT, TABLE), output())
        check_finished(found, self.out)


@dataclass(frozen=True)
class BenchPairs:
    """Relative poses of frames some frames apart: the tracker against SIFT, ORB, ICP, GICP and untrained features."""

    recordings: Positional[tuple[str, ...]]
    """Recordings with ground truth, of any layout, or synthetic[:SEED][:kinect]; PATH@FRAMES: the first FRAMES."""
    values: Values = FAST
    gap: tuple[int, ...] = (5, 10, 20, 40)
    """How many frames apart; several give a block of rows each."""
    pairs: int = 100
    """Pairs of each recording and gap, spread over it."""
    weights: tuple[Path, ...] = ()
    """Further weights of `idf-slam pretrain`, a row each."""
    baselines: bool = True
    """Whether untrained features, SIFT, ORB, ICP and GICP are measured beside."""
    json: bool = False
    """One line of JSON instead of the table, the last of the output."""
    out: Path | None = None
    """A folder for pairs.json, pairs.md and pictures of matches."""
    config: Path | None = None
    """A YAML file of values (a run's config.yaml, or a few lines of it); flags win over it, and it over the preset."""

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        import json

        from idfslam.bench_pairs import bench_pairs, markdown

        report = partial(console.print, highlight=False, markup=False, soft_wrap=True)
        options: dict[str, Any] = {"gaps": self.gap, "pairs": self.pairs, "weights": self.weights, "folder": self.out}
        options["against_baselines"] = self.baselines
        found = bench_pairs(self.recordings, values, **options, report=report)
        print(json.dumps(found) if self.json else markdown(found))


@dataclass(frozen=True)
class Pretrain:
    """Self-supervised training of the tracker's features on recordings, no poses needed; under torchrun divided among its processes."""

    recordings: Positional[tuple[Path, ...]]
    """Recordings of any layout, or synthetic[:SEED][:kinect]."""
    values: Annotated[PretrainConfig, arg(name="")] = PRETRAIN
    out: Path = Path("weights.safetensors")
    """The weights (safetensors), for `run --tracker.weights`; beside them the checkpoint."""
    start: Path | None = None
    """Weights to begin with; none given: random ones."""
    resume: bool = False
    """Go on from the checkpoint beside --out."""
    checkpoint_every: int = 500
    """Steps between checkpoints; 0: only at the end. Ctrl-C writes one, too."""
    validate: tuple[Path, ...] = ()
    """Recordings to measure the features on while they train; none of their frames is learnt from."""
    validate_every: int = 500
    """Steps between validations; 0: only at the end."""
    log: Path | None = None
    """A folder for TensorBoard's curves, which needs the extra [train]."""

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        from rich.progress import Progress

        from idfslam.datasets import open_recording
        from idfslam.tracking.pretraining import Outputs, pretrain

        recordings, held = ([open_recording(path) for path in paths] for paths in (self.recordings, self.validate))
        outputs = Outputs(self.out, self.log, self.checkpoint_every, self.validate_every)
        first = os.environ.get("RANK", "0") == "0"  # of the processes that torchrun starts
        with Progress(console=console, disable=not first) as progress:
            task = progress.add_task("pretraining", total=values.steps)

            def report(done: int, figures: Mapping[str, float]) -> None:
                losses = " ".join(f"{name} {value:.3g}" for name, value in figures.items() if "/" not in name)
                progress.update(task, completed=done, description=f"pretraining: {losses}")
                validation = " ".join(f"{name} {value:.3g}" for name, value in figures.items() if "/" in name)
                if validation:
                    progress.console.print(f"step {done}: {validation}", highlight=False, markup=False, soft_wrap=True)

            pretrain(recordings, outputs, values, held=held, start=self.start, resume=self.resume, report=report)
        if first:
            print(self.out)


def parse(arguments: Sequence[str]) -> Command:
    """The command with its flags. Raises ConfigError for a config file that cannot be used; exits with 2 on wrong usage."""
    values = _starting_values(arguments)
    commands: Any = (
        Annotated[Demo, subcommand("demo", default=Demo(values))]
        | Annotated[Run, subcommand("run", default=Run(tyro.MISSING, values))]
        | Annotated[Eval, subcommand("eval")]
        | Annotated[Mesh, subcommand("mesh")]
        | Annotated[Render, subcommand("render")]
        | Annotated[Bench, subcommand("bench", default=Bench(tyro.MISSING, values))]
        | Annotated[BenchPairs, subcommand("bench-pairs", default=BenchPairs(tyro.MISSING, values))]
        | Annotated[Pretrain, subcommand("pretrain")]
    )
    description = f"RGB-D SLAM with a neural tracker and a neural implicit map, version {__version__}."
    command: Command = tyro.cli(commands, prog="idf-slam", description=description, args=list(arguments), config=(DisallowNone,))
    return command


def _starting_values(arguments: Sequence[str]) -> Config:
    """What the flags start from: the values of --config over those of --preset."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--preset", nargs="?")
    parser.add_argument("--config", nargs="?", type=Path)
    found, _ = parser.parse_known_args(arguments)
    preset = found.preset if found.preset in PRESETS else None  # the parser proper complains of another one
    return load(found.config, base=preset) if found.config else PRESETS[preset or FAST.preset]


def prepare_process() -> None:
    """Threads and their waiting, to be called before torch or numba is imported; see the head of this file."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    threads = str(min(cores, _MOST_THREADS))
    for name, value in {
        "OMP_WAIT_POLICY": "PASSIVE",
        "GOMP_SPINCOUNT": "0",
        "OMP_NUM_THREADS": threads,
        "NUMBA_NUM_THREADS": threads,
    }.items():
        os.environ.setdefault(name, value)
    import cv2

    cv2.setNumThreads(1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs a command; exits with 1 and one line on the user's mistakes, with 2 on wrong usage."""
    try:
        command = parse(sys.argv[1:] if arguments is None else arguments)
        prepare_process()
        command(_console())
    except IdfSlamError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(1) from None
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        raise SystemExit(_INTERRUPTED) from None


def output() -> "Console":
    """Where figures and paths go: stdout."""
    from rich.console import Console

    return Console()


def _console() -> "Console":
    """Where progress and warnings go: stderr."""
    import logging

    from rich.console import Console
    from rich.logging import RichHandler

    console = Console(stderr=True)
    handler = RichHandler(console=console, show_time=False, show_path=False, markup=False)
    logging.basicConfig(level=logging.WARNING, handlers=[handler], format="%(message)s", force=True)
    return console


if __name__ == "__main__":
    main()
