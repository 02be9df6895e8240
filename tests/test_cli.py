"""The command line: what it takes, what wins over what, and how it ends on mistakes."""

import os
import re
import shutil
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

from idfslam.cli import command_line
from idfslam.cli.commands.run import OutputFlags, ViewerFlags
from idfslam.cli.recording_flags import CameraFlags, RecordingFlags, TopicFlags
from idfslam.compute.process import prepare_process
from idfslam.config import FAST, PAPER, PRETRAIN, Config, PretrainConfig


def run_values(*arguments: str) -> command_line.Run:
    command = command_line.parse(["run", "recording", *arguments])
    assert isinstance(command, command_line.Run)
    return command


def error_of(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 1) -> str:
    with pytest.raises(SystemExit) as caught:
        command_line.main(list(arguments))
    assert caught.value.code == code
    return capsys.readouterr().err


def test_help_is_quick_and_imports_nothing_heavy() -> None:
    script = (
        "import sys; from idfslam.cli import command_line\n"
        "try: command_line.main(['run', '--help'])\n"
        "except SystemExit: pass\n"
        "sys.exit(bool({'torch', 'numba', 'cv2', 'matplotlib', 'scipy'} & set(sys.modules)))"
    )
    seconds = []
    for _ in range(3):
        start = os.times()
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
        end = os.times()  # of the processor: other programs do not count
        seconds.append(end.children_user + end.children_system - start.children_user - start.children_system)
        assert done.returncode == 0, "a heavy package is imported before it is needed"
        assert "--mesh.resolution" in done.stdout
    assert min(seconds) < 1


def options_in_help(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *arguments: str) -> set[str]:
    monkeypatch.setenv("COLUMNS", "100")
    with pytest.raises(SystemExit) as caught:
        command_line.main(list(arguments))
    assert not caught.value.code
    return set(re.findall(r"(?m)^[│ ] (--\w[\w.-]*)", capsys.readouterr().out))


VALUES_IN_HELP = {
    *("--preset", "--seed", "--device", "--refine", "--calibrate", "--config", "--keyframes.translation", "--tracker.weights"),
    *("--finetune.enabled", "--loops.enabled", "--mesh.resolution", "--archive", "--movers"),
}


def test_help_of_run_shows_what_users_set(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    shown = options_in_help(capsys, monkeypatch, "run", "--help")
    camera = {f"--camera.{name}" for name in ("fx", "fy", "cx", "cy", "depth-scale", "reach", "readout", "depth-readout", "depth-delay")}
    camera |= {"--camera.guess", "--camera.field-of-view"}
    topics = {f"--topics.{name}" for name in ("colour", "depth", "camera-info", "poses")}
    recording = {"--start", "--frames", "--stride", "--format", "--camera-file", "--truth", "--map"}
    others = {"--out", "--overwrite", "--report", "--lost", "--viewer", "--port", "--host", "--checkpoint-every", "--resume"}
    assert shown == VALUES_IN_HELP | camera | topics | recording | others


@pytest.mark.parametrize("command", ["demo", "batch", "bench", "bench-pairs", "bench-odometry", "doctor", "pretrain"])
def test_help_of_other_commands_shows_no_more(command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    shown = options_in_help(capsys, monkeypatch, command, "--help")
    assert len(shown) <= 21
    assert command == "pretrain" or shown >= VALUES_IN_HELP


@pytest.mark.parametrize(("command", "values"), [("run", FAST), ("pretrain", PRETRAIN)])
def test_help_all_shows_every_value(
    command: str, values: Config | PretrainConfig, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    names = {key for key, value in asdict(values).items() if not isinstance(value, dict)}
    names |= {f"{section}.{key}" for section, inner in asdict(values).items() if isinstance(inner, dict) for key in inner}
    shown = options_in_help(capsys, monkeypatch, command, "--help-all")
    assert shown >= {f"--{name.replace('_', '-')}" for name in names}


def test_help_ends_with_the_way_to_all_options(capsys: pytest.CaptureFixture[str]) -> None:
    ends = {}
    for words in ("run --help", "run --help-all", "eval --help", "--help"):
        with pytest.raises(SystemExit):
            command_line.main(words.split())
        ends[words] = capsys.readouterr().out.splitlines()[-1]
    assert "All: idf-slam run --help-all" in ends.pop("run --help")
    assert not any("--help-all" in line for line in ends.values())


def test_flags_win_over_the_file_and_the_file_over_the_preset(tmp_path: Path) -> None:
    path = tmp_path / "values.yaml"
    path.write_text("seed: 5\nmapper: {pixels: 300, samples: 20}\n")
    values = run_values("--preset", "paper", "--config", str(path), "--mapper.pixels", "256").values
    assert (values.mapper.pixels, values.mapper.samples, values.seed) == (256, 20, 5)
    assert values.preset == "paper"
    assert values.field == PAPER.field


def test_without_flags_the_fast_preset_runs() -> None:
    assert run_values().values == FAST


def test_preset_with_an_equals_sign() -> None:
    assert run_values("--preset=paper").values == PAPER


def test_flags_of_run() -> None:
    flags = "--start 3 --frames 20 --stride 2 --device cpu --seed 9 --format tum --out there --camera.fx 500 --camera.depth-scale 5000"
    command = run_values(*flags.split(), "--mapper.no-active-sampling", "--field.encoding", "positional")
    assert command.recording == RecordingFlags(start=3, frames=20, stride=2, format="tum")
    assert command.output == OutputFlags(out=Path("there"))
    assert (command.values.device, command.values.seed) == ("cpu", 9)
    assert command.camera == CameraFlags(fx=500, depth_scale=5000)
    topics = run_values("--topics.colour", "/a", "--topics.depth", "/b", "--topics.camera-info", "/c", "--topics.poses", "/d").topics
    assert topics == TopicFlags("/a", "/b", "/c", "/d")
    assert command.values.mapper.active_sampling is False
    assert command.values.field.encoding == "positional"


def test_flags_of_the_other_commands() -> None:
    demo = command_line.parse(["demo", "--frames", "20", "--room", "3", "--seed", "1", "--out", "there"])
    assert isinstance(demo, command_line.Demo)
    assert (demo.frames, demo.room, demo.values.seed, demo.out) == (20, 3, 1, Path("there"))
    assert command_line.parse(["eval", "dir", "--gt", "a.txt", "--gt-mesh", "b.ply", "--protocol", "nice"]) == command_line.Eval(
        Path("dir"), Path("a.txt"), Path("b.ply"), "nice"
    )
    assert command_line.parse(["mesh", "dir", "--resolution", "0.01"]) == command_line.Mesh(Path("dir"), 0.01)
    assert command_line.parse(["render", "dir", "--frames", "1", "5"]) == command_line.Render(Path("dir"), (1, 5))


def test_the_viewers_place_may_be_left_out() -> None:
    assert run_values("--viewer").live_view.viewer == "auto"
    assert run_values("--viewer", "--port", "99").live_view == ViewerFlags("auto", 99)
    assert run_values("--viewer", "web").live_view.viewer == "web"


def test_a_tilde_is_the_users_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/someone")
    monkeypatch.setenv("USERPROFILE", "/home/someone")
    home = Path("/home/someone")
    assert run_values("--out=~/results").output.out == home / "results"
    assert run_values("--out", "~/results").output.out == home / "results"
    assert run_values("--out", "a~b").output.out == Path("a~b")


def test_resume_takes_no_other_options(capsys: pytest.CaptureFixture[str]) -> None:
    message = error_of(capsys, *["run", "--resume", "there", "--frames", "20", "--mapper.pixels", "64", "--checkpoint-every", "9"], code=2)
    assert "leave out all else (found frames, pixels)" in message


@pytest.mark.parametrize(
    "arguments",
    ["run", "run x --no-such-flag 1", "run x --preset slow", "run x --mapper.pixels many", "eval x --protocol none", "bogus", ""],
)
def test_wrong_usage_ends_with_2(arguments: str, capsys: pytest.CaptureFixture[str]) -> None:
    message = error_of(capsys, *arguments.split(), code=2)
    assert "Traceback" not in message


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["run", "--ot", "x"], "unknown option --ot, did you mean --out? (help: idf-slam run --help)"),
        (["eval", "--gtt", "x"], "unknown option --gtt, did you mean --gt? (help: idf-slam eval --help)"),
        (["run", "x", "--frames"], "--frames: expected a value behind it (help: idf-slam run --help)"),
        (["run", "x", "--start", "9" * 5000], "--start: found a number of thousands of digits, expected INT (help: idf-slam run --help)"),
        (
            ["eval", "x", "--protocol", "no"],
            "--protocol: found no, expected one of coslam, eslam, neural-rgbd, nice, seen (help: idf-slam eval --help)",
        ),
    ],
)
def test_wrong_usage_says_what_is_wrong(arguments: list[str], line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert error_of(capsys, *arguments, code=2) == f"error: {line}\n"


def test_a_very_long_argument_is_not_repeated_whole(capsys: pytest.CaptureFixture[str]) -> None:
    assert len(error_of(capsys, "run", "x", "y" * 5000, code=2)) < 1800


def test_help_is_a_command_too(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        command_line.main(["help"])
    assert caught.value.code == 0
    assert "usage: idf-slam COMMAND" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        ("demo --room -1", "--room -1 --frames 240, expected a seed of at least 0 and at least 1 frame"),
        ("demo --frames 0", "--room 0 --frames 0, expected"),
        ("run no-such-recording", "no-such-recording"),
        ("run synthetic --config no-such.yaml", "no-such.yaml"),
        ("run . --mapper.pixels 0", "error:"),
        ("demo --mapper.learning-rate nan", "mapper.learning_rate is nan"),
        ("eval no-such-folder", "no-such-folder: no such folder"),
        ("mesh no-such-folder", "no-such-folder: no such folder"),
        ("mesh no-such-folder --resolution 0", "--resolution 0.0, expected metres above 0"),
        ("render no-such-folder", "no-such-folder: no such folder"),
    ],
)
def test_a_users_mistake_is_one_line_and_ends_with_1(
    arguments: str, found: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    message = error_of(capsys, *arguments.split())
    assert message.startswith("error: ")
    assert found in message
    assert message.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_output_that_nobody_reads_on_is_no_crash() -> None:
    command = f"{sys.executable} -m idfslam.cli --help | head -c 1"
    done = subprocess.run(command, shell=True, check=True, capture_output=True, text=True)
    assert len(done.stdout) == 1
    assert done.stderr == ""


def test_threads_that_the_user_chose_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_WAIT_POLICY", "ACTIVE")
    prepare_process()
    assert os.environ["OMP_WAIT_POLICY"] == "ACTIVE"


@pytest.mark.parametrize("words", [["run", ""], ["run", "room", "--out", ""]])
def test_an_empty_word_is_refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        command_line.parse(words)
    assert caught.value.code == 2
    assert f"error: the word behind {words[-2]} is empty, expected a value" in capsys.readouterr().err


def test_tables_are_readable_in_a_narrow_terminal(
    known_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    run = shutil.copytree(known_run, tmp_path / "run")
    command_line.main(["eval", str(run)])
    assert re.search(r"│ ATE \[cm\].*│ +\d+\.\d+ │", capsys.readouterr().out)
