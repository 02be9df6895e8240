"""Settings of the process that numerical libraries read when they are imported: the number of threads, and how idle threads wait.

The libraries use one thread for each core, at most 8 (the networks are small). Idle threads sleep instead of spinning: with another program
on the same cores, spinning costs most of the speed. The environment variables OMP_NUM_THREADS, NUMBA_NUM_THREADS, OMP_WAIT_POLICY and
GOMP_SPINCOUNT take precedence if they are set. OpenCV runs on one thread.
"""

import gc
import os

from idfslam.compute.host import default_threads


def prepare_process() -> None:
    """Sets the threads of the process as the head of this file says. It must be called before torch or numba is imported."""
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


def keep_what_is_imported() -> None:
    """Takes all that exists now out of the garbage collector's searches. To be called after the imports of a long computation.

    Torch, scipy and Numba are some 290 000 objects that live as long as the process, and each full search goes through all of them.
    """
    gc.freeze()
