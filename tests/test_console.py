"""What a console shows: streams that cannot show everything or are closed, how much is told, and errors in one line."""

import errno
import io
import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest

from idfslam.cli import command_line, failure, usage
from idfslam.cli.verbosity import Verbosity, open_console, take_verbosity

CLI = [sys.executable, "-m", "idfslam.cli"]


def wrong(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as caught:
        command_line.main(arguments)
    assert caught.value.code == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ("rnu x", "unknown command rnu, did you mean run? (help: idf-slam --help)"),
        ("--versio", "unknown option --versio, did you mean --version? (help: idf-slam --help)"),
        ("run x --frame 3", "unknown option --frame, did you mean --frames? (help: idf-slam run --help)"),
        ("run x --mapper.pixel=3", "unknown option --mapper.pixel, did you mean --mapper.pixels? (help: idf-slam run --help)"),
        ("run x --zzzzzz", "unknown option --zzzzzz (help: idf-slam run --help)"),
        ("mesh a b", "unexpected argument 'b' (help: idf-slam mesh --help)"),
        ("run x --frames abc", "--frames: found 'abc', expected INT (help: idf-slam run --help)"),
        ("run x --mapper.pixels abc", "--mapper.pixels: found 'abc', expected INT (help: idf-slam run --help)"),
        ("run x --preset slow", "--preset: found slow, expected one of fast, paper, imap, nice (help: idf-slam run --help)"),
        ("eval", "missing: PATH Result folder (help: idf-slam eval --help)"),
        ("run", "run: expected a recording, or --resume and the result folder of a run (help: idf-slam run --help)"),
    ],
)
def test_wrong_usage_is_one_line_with_the_nearest_name(arguments: str, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert wrong(capsys, *arguments.split()) == f"error: {line}\n"


def test_without_a_command_all_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    lines = wrong(capsys).splitlines()
    assert lines[0] == "usage: idf-slam COMMAND [OPTIONS]"
    assert {line.split()[0] for line in lines if line.startswith("  ")} >= set(command_line.COMMANDS)
    with pytest.raises(SystemExit) as caught:
        command_line.main(["--help"])
    assert not caught.value.code
    assert capsys.readouterr().out.splitlines() == lines


def test_help_of_every_command_names_the_common_options(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        command_line.main(["eval", "--help"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[-3:] == [f"{flags:15} {text}" for flags, text in list(usage.COMMON.items())[1:]]


@pytest.mark.parametrize("arguments", [["--version"], ["run", "--version"]])
def test_version_is_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    command_line.main(arguments)
    line = capsys.readouterr().out
    assert line.count("\n") == 1
    assert line.startswith(f"idf-slam {command_line.version_line().split()[1]}")
    assert [word.split()[0] for word in line.split(", ")] == ["idf-slam", "Python", "torch", "Numba"]


def test_verbosity_stands_before_or_after_the_command() -> None:
    assert take_verbosity(["run", "x"]) == (["run", "x"], Verbosity.NORMAL)
    assert take_verbosity(["-q", "run", "x"]) == (["run", "x"], Verbosity.QUIET)
    assert take_verbosity(["run", "x", "--verbose"]) == (["run", "x"], Verbosity.VERBOSE)
    assert take_verbosity(["-v", "run", "--quiet"]) == (["run"], Verbosity.QUIET)


@pytest.mark.parametrize(
    ("verbosity", "shown"),
    [
        (Verbosity.QUIET, ["warning: two"]),
        (Verbosity.NORMAL, ["one", "warning: two"]),
        (Verbosity.VERBOSE, ["zero", "one", "warning: two"]),
    ],
)
def test_log_lines_by_verbosity(verbosity: Verbosity, shown: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    console = open_console(verbosity)
    log = logging.getLogger("idfslam.some.part")
    log.debug("zero")
    log.info("one")
    log.warning("two")
    console.print("progress")
    assert capsys.readouterr().err.splitlines() == shown + (["progress"] if verbosity is not Verbosity.QUIET else [])


def run_cli(*arguments: str, **variables: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([*CLI, *arguments], capture_output=True, text=True, encoding="utf-8", env=os.environ | variables)


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_a_console_that_lacks_letters_shows_them_escaped(encoding: str, tmp_path: Path) -> None:
    folder = tmp_path / "日本"
    done = run_cli("mesh", str(folder), PYTHONIOENCODING=encoding)
    assert done.returncode == 1
    assert done.stderr == f"error: {tmp_path}/\\u65e5\\u672c: no such folder; expected the results of `idf-slam run`\n"
    assert run_cli("mesh", "--help", PYTHONIOENCODING=encoding).returncode == 0


def test_letters_in_results_are_escaped_too(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    narrow = io.TextIOWrapper(io.BytesIO(), encoding="cp1252", write_through=True)
    monkeypatch.setattr(sys, "stdout", narrow)
    command_line.prepare_streams()
    print("aus 日本")
    assert narrow.buffer.getvalue() == rb"aus \u65e5\u672c" + os.linesep.encode()


@pytest.mark.skipif(os.name == "nt", reason="needs a shell of Unix")
@pytest.mark.parametrize("redirection", [">&-", "2>&-", "<&-", "<&- >&- 2>&-"])
def test_closed_streams(redirection: str, tmp_path: Path) -> None:
    done = subprocess.run(f"{' '.join(CLI)} --version {redirection}", shell=True, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_under_stdout_is_one_line() -> None:
    done = subprocess.run(f"{' '.join(CLI)} --help > /dev/full", shell=True, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr == "error: no space is left on the disk; make room and run again\n"


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (MemoryError(), "error: out of memory (while computing); close other programs, or use fewer frames (--frames, --stride)"),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory: 8 bytes"), "error: out of memory (DefaultCPUAllocator: can't allocate"),
        (OSError(errno.ENOSPC, "No space left on device", "a/b"), "error: a/b: no space is left on the disk; make room and run again"),
        (PermissionError(errno.EACCES, "Permission denied", "a/b"), "error: a/b: Permission denied"),
        (ImportError("libGL.so.1: cannot open shared object file"), "error: a package cannot be loaded (libGL.so.1: cannot open"),
    ],
)
def test_errors_of_the_machine_are_one_line(error: Exception, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught, failure.one_line_errors():
        raise error
    assert caught.value.code == 1
    told = capsys.readouterr().err
    assert told.startswith(line)
    assert told.count("\n") == 1


def test_a_fault_of_the_program_is_one_line_and_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(failure.tempfile, "tempdir", str(tmp_path))
    with pytest.raises(SystemExit) as caught, failure.one_line_errors():
        raise ZeroDivisionError("division\nby zero")
    assert caught.value.code == 1
    (report,) = tmp_path.glob("idf-slam-error-*.log")
    told = f"error: unexpected ZeroDivisionError: division by zero; this is a fault of idf-slam, please report it with {report}\n"
    assert capsys.readouterr().err == told
    written = report.read_text(encoding="utf-8")
    assert written.startswith(usage.version_line())
    assert "Traceback" in written
    with pytest.raises(SystemExit), failure.one_line_errors(verbose=True):
        raise ZeroDivisionError
    assert "Traceback" in capsys.readouterr().err


def test_ctrl_c_ends_with_130(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught, failure.one_line_errors():
        raise KeyboardInterrupt
    assert caught.value.code == 130
    assert capsys.readouterr().err == "interrupted\n"
