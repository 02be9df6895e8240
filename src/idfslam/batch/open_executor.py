"""The executor that the command line asks for."""

from idfslam.batch.executor import Executor
from idfslam.batch.local_executor import LocalExecutor
from idfslam.compute.host import cores, memory


def open_executor(cluster: str | None, workers: int | None, *, jobs: int, gpus: float = 0.0, retries: int = 0) -> Executor:
    """The executor by what the command line says: `cluster` None is this machine, `auto` or an address is Ray.

    workers: processes at once; None: as many as there are cores, no more than `jobs`. gpus: of the cluster, each.
    Raises ConfigError where Ray is not installed, the cluster cannot be reached, or has no place for a run.
    """
    if cluster is None:
        return LocalExecutor(max(1, min(jobs, default_workers())) if workers is None else workers, retries=retries)
    from idfslam.batch.ray_executor import RayExecutor

    return RayExecutor(cluster, workers, jobs=jobs, gpus=gpus, retries=retries)


def default_workers() -> int:
    """Runs at once on this machine: one a core (a second core makes a run half as fast again), as far as memory goes."""
    found = memory()
    return cores() if found is None else max(1, min(cores(), found[1] // _MEMORY_OF_A_RUN))


_MEMORY_OF_A_RUN = 3 * 2**29  # 1.5 GiB: 0.9 GiB measured (docs/results.md), and what a longer recording adds
