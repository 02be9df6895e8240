"""Settings of the whole process that its numerical libraries read when they are imported: threads, and how they wait.

The libraries use one thread a core, at most 8 (the networks are small), and idle threads sleep instead of spinning: with another program
on the same cores, spinning costs most of the speed. OMP_NUM_THREADS, NUMBA_NUM_THREADS, OMP_WAIT_POLICY and GOMP_SPINCOUNT, where set,
win. OpenCV runs on one thread.
"""

import os

from idfslam.compute.host import default_threads


def prepare_process() -> None:
    """Threads and their waiting, to be called before torch or numba is imported; see the head of this file."""
    threads = str(default_threads())
    for name, value in {
        "OMP_WAIT_POLICY": "PASSIVE",
        "GOMP_SPINCOUNT": "0",
        "OMP_NUM_THREADS": threads,
        "NUMBA_NUM_THREADS": threads,
    }.items():
        os.environ.setdefault(name, value)
    import cv2

    cv2.setNumThreads(1)
