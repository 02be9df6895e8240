"""Settings that hold for every test: set before torch or numba is imported."""

import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # idle threads sleep: tests share the cores
os.environ.setdefault("GOMP_SPINCOUNT", "0")

import cv2
from hypothesis import settings

cv2.setNumThreads(1)
settings.register_profile("suite", deadline=None, derandomize=True, max_examples=50)  # timings vary on a shared machine
settings.load_profile("suite")
