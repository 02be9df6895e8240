"""Many runs: the list's grammar, what becomes of failures, and processes that are killed in the middle, here and on Ray."""

import json
import os
import platform
import threading
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import psutil
import pytest

from idfslam.batch.batch import DONE, FAILED, Row, batch, check_done, progress_line
from idfslam.batch.batch_file import BatchJob, read_batch
from idfslam.batch.executor import Crash, Executor, JobOutcome, NodeFailure, thread_share
from idfslam.batch.local_executor import LocalExecutor
from idfslam.batch.open_executor import open_executor
from idfslam.cli import command_line
from idfslam.compute.host import cores, default_threads
from idfslam.config import FAST
from idfslam.errors import ConfigError, RecordingError, ResultError

QUICK = (
    *("--frames", "4", "--mapper.first-iterations", "5", "--refinement.updates", "1", "--mesh.resolution", "0.1"),
    *("--device", "cpu", "--no-report"),
)


def items(recording: Path, count: int = 3) -> list[BatchJob]:
    return [BatchJob(f"box-{i}", str(recording), (*QUICK, "--seed", str(i))) for i in range(count)]


class ScriptedExecutor(Executor):
    """Answers for each recording what is written for it: an error, or how often it is killed before it ends well."""

    def __init__(self, *, crashes: int = 0, error: str | None = None, retries: int = 2) -> None:
        super().__init__(1, retries=retries)
        self.crashes, self.error = crashes, error

    def _attempt(self, module: str, arguments: tuple[str, ...]) -> tuple[str | None, str]:
        self.crashes -= 1
        if self.crashes >= 0:
            raise Crash("killed by SIGKILL")
        return self.error, "node-7"


def test_text_list(box_recording: Path, tmp_path: Path) -> None:
    (tmp_path / "my room").symlink_to(box_recording)
    noisy = "synthetic:3:kinect seed=1 out=noisy mapper.active_sampling=false"
    (tmp_path / "list.txt").write_text(f"# all of them\n\n'my room' frames=5 camera.fx=525 # wide\n{noisy}\n'my room'\n")
    first, second, third, fourth = read_batch([str(tmp_path / "list.txt"), f"{box_recording}@7"], FAST)
    link = str(tmp_path / "my room")  # the name that the user gave, not that of what it leads to
    assert first == BatchJob("my room", link, ("--frames", "5", "--camera.fx", "525"))
    assert second == BatchJob("noisy", "synthetic:3:kinect", ("--seed", "1", "--mapper.no-active-sampling"))
    assert third == BatchJob("my room-2", link)
    assert fourth == BatchJob("box", str(box_recording), ("--frames", "7"))
    run = command_line.parse(["run", second.path, *second.flags])
    assert isinstance(run, command_line.Run)
    assert (run.values.seed, run.values.mapper.active_sampling) == (1, False)


def test_yaml_list(tmp_path: Path) -> None:
    (tmp_path / "list.yaml").write_text("- synthetic:1\n- {path: synthetic, frames: 9, mapper: {pixels: 64}, camera.depth_scale: 5000}\n")
    first, second = read_batch([str(tmp_path / "list.yaml")], FAST)
    assert first == BatchJob("synthetic-1", "synthetic:1")
    assert second == BatchJob("synthetic", "synthetic", ("--frames", "9", "--mapper.pixels", "64", "--camera.depth-scale", "5000"))


@pytest.mark.parametrize(
    ("name", "text", "error"),
    [
        ("l.txt", "synthetic frames", r"l.txt:1: 'frames', expected NAME=VALUE"),
        ("l.txt", "synthetic 'x", r"l.txt:1: No closing quotation"),
        ("l.txt", "# nothing\n", "lists no recordings"),
        ("l.txt", "synthetic\nsynthetic frames=0", "l.txt:2: start 0, stride 1, frames 0"),
        ("l.txt", "synthetic frames=many", "l.txt:1: 'frames' is 'many'"),
        ("l.txt", "synthetic mapper.pixel=4", "l.txt:1: unknown key 'pixel'"),
        ("l.txt", "synthetic mapper.pixels=0", "mapper.pixels is 0"),
        ("l.txt", "synthetic preset=paper", "give it as --preset"),
        ("l.txt", "synthetic out=../elsewhere", "the name of a folder inside --out"),
        ("l.yaml", "path: synthetic", "found dict, expected a list"),
        ("l.yaml", "- {frames: 4}", "entry 1: .*with 'path'"),
        ("l.yaml", "- [", "is not YAML"),
    ],
)
def test_lists_that_cannot_be_run(name: str, text: str, error: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=error):
        read_batch([str(tmp_path / name)], FAST)


def test_missing_recordings_and_lists_are_told_before_the_first_run(tmp_path: Path) -> None:
    (tmp_path / "list.txt").write_text("synthetic\nnowhere\n")
    with pytest.raises(RecordingError, match="nowhere"):
        read_batch([str(tmp_path / "list.txt")], FAST)
    with pytest.raises(ConfigError, match=r"none.txt: cannot be read"):
        read_batch([str(tmp_path / "none.txt")], FAST)


def test_a_killed_process_is_started_again_and_one_with_an_error_is_not() -> None:
    assert ScriptedExecutor(crashes=2).run_module("m", "run", "x").attempts == 3
    given_up = ScriptedExecutor(crashes=3).run_module("m", "run", "x")
    assert (given_up.error, given_up.attempts) == ("killed by SIGKILL", 3)
    failed = ScriptedExecutor(error="x: no such file").run_module("m", "run", "x")
    assert (failed.error, failed.host, failed.attempts) == ("x: no such file", "node-7", 1)


def test_after_a_stop_nothing_begins() -> None:
    executor = ScriptedExecutor()
    executor.stop()
    assert executor.run_module("m", "run", "x") == JobOutcome("interrupted", 0.0, platform.node(), 0)


def test_each_worker_gets_its_share_of_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        monkeypatch.setenv(name, str(default_threads()))
    monkeypatch.setattr("idfslam.compute.host.cores", lambda: 12)
    assert [default_threads(n) for n in (1, 2, 3, 12, 40)] == [8, 6, 4, 1, 1]
    monkeypatch.setenv("OMP_NUM_THREADS", "5")  # the user's own choice; of the other the usual 8 are divided
    monkeypatch.setenv("NUMBA_NUM_THREADS", "8")
    assert thread_share(2) == {"NUMBA_NUM_THREADS": "2"}
    assert cores() >= 1


@pytest.mark.slow
def test_a_batch_here(box_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "list.txt").write_text(f"{box_recording} frames=4 mapper.first_iterations=5\n{box_recording} start=99 out=too-late\n")
    flags = ["--out", str(tmp_path / "out"), "--workers", "2", "--refinement.updates", "1", "--mesh.resolution", "0.1"]
    with pytest.raises(SystemExit) as caught:
        command_line.main(["batch", str(tmp_path / "list.txt"), *flags])
    assert caught.value.code == 1
    said = capsys.readouterr()
    assert "too-late: start 99 lies outside the 14 frames" in said.out
    assert "error: 1 of 2 runs failed (too-late: start 99" in said.err
    good, bad = json.loads((tmp_path / "out/batch.json").read_text())
    assert (good["name"], good["status"], good["frames"], good["attempts"]) == ("box", DONE, 4, 1)
    assert 0 <= good["ate_m"] < 0.02
    assert (bad["status"], bad["frames"]) == (FAILED, None)
    assert (tmp_path / "out/box/mesh.ply").is_file()


def test_failures_are_told() -> None:
    rows = [Row("a", "/a", DONE, None, 10, 0.0123, 5.0, 0), Row("b", "/b", FAILED, "no depth")]
    assert [progress_line(row) for row in rows] == ["a: 10 frames, 5.00 frames/s, ATE 1.23 cm", "b: failed: no depth"]
    check_done(rows[:1], Path("out"))
    with pytest.raises(ResultError, match=r"1 of 2 runs failed \(b: no depth\)"):
        check_done(rows, Path("out"))


def kill_once(find: Callable[[], list[psutil.Process]]) -> threading.Thread:
    """A thread that kills the first process that `find` finds, a second after it is there: in the middle of its run."""

    def watch() -> None:
        while not (found := find()):
            time.sleep(0.1)
        time.sleep(1)
        found[0].kill()

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    return thread


def children_with(word: str) -> list[psutil.Process]:
    found = []
    for process in psutil.Process().children(recursive=True):
        try:
            if word in " ".join(process.cmdline()):
                found.append(process)
        except psutil.Error:
            continue
    return found


@pytest.mark.slow
def test_a_process_killed_in_the_middle_is_run_again(box_recording: Path, tmp_path: Path) -> None:
    killer = kill_once(lambda: children_with("idfslam.cli run"))
    with LocalExecutor(2, retries=1) as executor:
        rows = batch(items(box_recording, 2), FAST, tmp_path, executor)
    killer.join(10)
    assert not killer.is_alive()
    assert [row.status for row in rows] == [DONE, DONE]
    assert sorted(row.attempts for row in rows) == [1, 2]


class FailingNode(Executor):
    """Its node fails some times; the third attempt after that is killed, and the next one ends well."""

    def __init__(self, failures: int) -> None:
        super().__init__(1, retries=1, wait=5.0)
        self.left: list[Exception | None] = [NodeFailure("the node failed")] * failures + [Crash("killed"), None]
        self.waits: list[float] = []
        self._stopped.wait = lambda seconds=None: self.waits.append(seconds) or False  # type: ignore[method-assign, assignment, func-returns-value]

    def _attempt(self, module: str, arguments: tuple[str, ...]) -> tuple[str | None, str]:
        if (error := self.left.pop(0)) is not None:
            raise error
        return None, "node-7"


def test_failures_of_a_node_are_waited_for_and_counted_apart_from_retries() -> None:
    executor = FailingNode(failures=5)
    outcome = executor.run_module("some.module")
    assert (outcome.error, outcome.host, outcome.attempts) == (None, "node-7", 7)
    assert executor.waits == [5.0, 10.0, 20.0, 40.0, 60.0, 60.0]


def test_a_cluster_that_keeps_failing_is_given_up() -> None:
    outcome = FailingNode(failures=30).run_module("some.module")
    assert (outcome.error, outcome.attempts) == ("the node failed", 11)


def test_without_ray_the_pip_line_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    with pytest.raises(ConfigError, match="-m pip install ray;"):
        open_executor("auto", None, jobs=1)


SLOW = """
import time
from pathlib import Path
from idfslam.compute.interrupt import stop_on_interrupt

def main(arguments):
    with stop_on_interrupt() as stop:
        Path(arguments[0], "begun").touch()
        while not stop.is_set():  # as between two frames
            time.sleep(0.05)
    Path(arguments[0], "results").touch()
"""


@pytest.mark.slow
@pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed: pip install 'idf-slam[cluster]'")
def test_a_stop_on_ray_lets_runs_write_their_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "slow_run.py").write_text(SLOW)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    monkeypatch.setenv("RAY_worker_niceness", "0")
    ended: list[JobOutcome] = []
    with open_executor("auto", 1, jobs=1) as executor:
        run = threading.Thread(target=lambda: ended.append(executor.run_module("slow_run", str(tmp_path))))
        run.start()
        while not (tmp_path / "begun").exists():
            time.sleep(0.1)
        executor.stop()
        run.join(60)
        assert [execution.error for execution in ended] == [None]
    assert (tmp_path / "results").exists()


@pytest.mark.slow
@pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed: pip install 'idf-slam[cluster]'")
def test_a_ray_worker_killed_in_the_middle_is_replaced(box_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import ray

    monkeypatch.setenv("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    monkeypatch.setenv("RAY_worker_niceness", "0")  # 15 otherwise: beside another program hardly anything would be left for the workers
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="error")
    too_many = BatchJob("too-many", str(box_recording), ("--frames", "99"))
    with open_executor("auto", 2, jobs=4, retries=2) as executor:
        killer = kill_once(lambda: children_with("ray::run_here"))
        rows = batch([*items(box_recording, 3), too_many], FAST, tmp_path, executor)
    killer.join(10)
    assert not killer.is_alive()
    assert [(row.name, row.status) for row in rows] == [("box-0", DONE), ("box-1", DONE), ("box-2", DONE), ("too-many", FAILED)]
    assert "frames 99 from start 0" in str(rows[-1].error)
    assert sum(row.attempts for row in rows) == 5
    assert not ray.is_initialized()
    for address in ("127.0.0.1:1", "somewhere"):
        with pytest.raises(ConfigError, match=f"--cluster {address}: .*; expected 'auto' or the address"):
            open_executor(address, None, jobs=1)
