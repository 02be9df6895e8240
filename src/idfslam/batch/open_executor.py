"""Opens the executor that the command line selects."""

from idfslam.batch.executor import Executor
from idfslam.batch.local_executor import LocalExecutor
from idfslam.compute.host import cores, memory
from idfslam.errors import ConfigError

_MEMORY_OF_A_RUN = 3 * 2**29  # [bytes] 0.9 GiB measured (docs/results.md), and room for a longer recording; larger: fewer runs at once


def open_executor(cluster: str | None, workers: int | None, *, jobs: int, gpus: float = 0.0, retries: int = 0) -> Executor:
    """The executor for `jobs` runs.

    cluster: None: this machine; `auto` or an address: Ray. workers: processes at once; None: one for each core, at most `jobs`.
    gpus: GPUs of the cluster for each run.
    Raises ConfigError if Ray is not installed, if the cluster cannot be reached, if no node can hold a run, and for GPUs without a cluster.
    """
    if not 0 <= gpus < float("inf"):
        raise ConfigError(f"--gpus {gpus:g}, expected a number of at least 0")
    if gpus and cluster is None:
        raise ConfigError(f"--gpus {gpus:g}: they are those of a cluster, give --cluster as well, or leave it out")
    if cluster is None:
        return LocalExecutor(max(1, min(jobs, default_workers())) if workers is None else workers, retries=retries)
    from idfslam.batch.ray_executor import RayExecutor

    return RayExecutor(cluster, workers, jobs=jobs, gpus=gpus, retries=retries)


def default_workers() -> int:
    """Number of runs at once on this machine: one for each core, fewer if the available memory is too small.

    One core each is most efficient: a second core makes a run only half as fast again.
    """
    sizes = memory()
    return cores() if sizes is None else max(1, min(cores(), sizes[1] // _MEMORY_OF_A_RUN))
