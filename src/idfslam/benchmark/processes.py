"""The processes of the benchmark: one for each run and each evaluation."""

from idfslam.batch.executor import Executor
from idfslam.batch.recordings import RecordingSpec
from idfslam.errors import IdfSlamError


class BenchError(IdfSlamError):
    """A process of the benchmark failed; the message is its last line."""


def run_module(executor: Executor, module: str, *arguments: str) -> None:
    """Runs `python -m MODULE ARGUMENTS`. Raises BenchError if it fails."""
    outcome = executor.run_module(module, *arguments)
    if outcome.error is not None:
        raise BenchError(outcome.error)


def frames_flag(spec: RecordingSpec) -> list[str]:
    """The words that limit a command to the frames that are measured."""
    return [] if spec.frames is None else ["--frames", str(spec.frames)]
