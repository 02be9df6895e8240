"""The fast preset from the first frame to the mesh in plain torch, without a kernel, held against the run that the kernels compute."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numba.core.dispatcher import Dispatcher
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import idfslam
from helpers.small_config import small
from idfslam.compute.backend import Backend, backend_of, pick, plain_torch
from idfslam.config import FAST
from idfslam.datasets import open_recording
from idfslam.frame import Frame, FrameResult, Status
from idfslam.mapping.saved_map import SavedMap
from idfslam.slam import Slam
from idfslam.views.image_based_rendering import MapViews

SMALL = replace(
    small(),
    mapper=replace(small().mapper, first_iterations=100, step_pixels=400),
    refinement=replace(small().refinement, updates=1),
    finetune=replace(FAST.finetune, every=1, keyframes=2),
    fusion=replace(FAST.fusion, voxel=0.05),
    keyframes=replace(small().keyframes, translation=0.045),  # the camera moves by 50 mm in three frames: rounding would decide there
)
FRAMES, BLANK = 8, 5  # the camera is lost at the blank frame and found again at the next
CELL = 0.1  # [m] of the mesh
KERNELS = {path.stem for path in Path(idfslam.__file__).parent.glob("*/kernels/numba_*.py")}
needs_cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="this machine has no CUDA device")
needs_triton = pytest.mark.skipif(
    torch.cuda.is_available() and backend_of(torch.device("cuda")) is not Backend.TRITON, reason="the package triton is not installed"
)


@dataclass(frozen=True, repr=False)
class Run:
    """What a run gave."""

    results: list[FrameResult]
    trajectory: NDArray[np.float64]
    keyframes: list[int]
    bounds: NDArray[np.float64]  # (2, 3) [m] of the mesh
    depth: NDArray[np.float32]  # (H, W) [m] that the map shows the first frame's camera
    kernels: set[str]  # modules of the compiled kernels that were called

    def losses(self, frame: int) -> dict[str, float]:
        return self.results[frame].losses


@contextmanager
def watched() -> Iterator[set[str]]:
    """The names of the modules below `kernels/` whose compiled functions are called within, by any thread."""
    called: set[str] = set()

    def call(self: Any, *args: Any, **kwargs: Any) -> Any:
        *_, folder, module = self.py_func.__module__.split(".")
        if folder == "kernels":
            called.add(module)
        return super(Dispatcher, self).__call__(*args, **kwargs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Dispatcher, "__call__", call)
        yield called


def run(recording: Path, device: str, *, plain: bool) -> Run:
    """SLAM on the first frames of a recording, one of them blank; then a mesh, and a view of the map."""
    data = open_recording(recording, frames=FRAMES)
    with watched() as kernels, plain_torch() if plain else nullcontext():
        slam = Slam(replace(SMALL, device=device))
        frames = [data[i] for i in range(FRAMES)]
        frames[BLANK] = Frame.blank(frames[BLANK].index, frames[BLANK].timestamp, data.camera)
        results = [slam.process(frame) for frame in frames]
        slam.finish()
        saved, archive = SavedMap(slam.mapper.learnt(), slam.coverage.views()), slam.archive()
        depth = saved.render(np.eye(4), data.camera)[1]
        assert archive is not None
        MapViews(saved, archive).render(np.eye(4), data.camera.resized(40, 30))
        return Run(results, slam.trajectory(), [k.index for k in slam.graph.keyframes], slam.mesh(CELL).bounds, depth, kernels)


@pytest.fixture(scope="module")
def compiled(box_recording: Path) -> Run:
    return run(box_recording, "cpu", plain=False)


@pytest.mark.slow
def test_the_compiled_run_calls_every_kernel(compiled: Run) -> None:
    assert compiled.kernels == KERNELS
    assert [result.status for result in compiled.results] == [Status.LOST if i == BLANK else Status.OK for i in range(FRAMES)]
    assert "finetune_photometric" in compiled.losses(BLANK)
    assert len(compiled.keyframes) >= 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("device", "plain"),
    [
        pytest.param("cpu", True, id="cpu"),
        pytest.param("cuda", True, id="cuda", marks=needs_cuda),
        pytest.param("cuda", False, id="cuda with triton", marks=[needs_cuda, needs_triton]),
    ],
)
def test_another_backend_gives_the_same_run(compiled: Run, box_recording: Path, device: str, plain: bool) -> None:
    """Samples are drawn in another order and sums round differently, so runs agree to millimetres, not to the bit.

    Found on a CPU: poses differ by 2.1 mm and 0.06 degrees, losses by 3 %, the mesh's bounds by 2 mm, depth by 1.2 mm in the median.
    """
    found = run(box_recording, device, plain=plain)
    if plain:
        assert found.kernels == set()
    assert [result.status for result in found.results] == [result.status for result in compiled.results]
    assert found.keyframes == compiled.keyframes
    change = np.linalg.inv(compiled.trajectory) @ found.trajectory
    assert np.linalg.norm(change[:, :3, 3], axis=-1).max() < 0.005
    assert Rotation.from_matrix(change[:, :3, :3]).magnitude().max() < np.deg2rad(0.2)
    for i in compiled.keyframes[:-1]:  # the last became one after the last frame
        assert found.losses(i)["total"] == pytest.approx(compiled.losses(i)["total"], rel=0.15)
    assert found.losses(BLANK)["finetune_photometric"] == pytest.approx(compiled.losses(BLANK)["finetune_photometric"], rel=0.15)
    np.testing.assert_allclose(found.bounds, compiled.bounds, atol=0.05)
    seen = (found.depth > 0) & (compiled.depth > 0)
    assert seen.mean() > 0.98
    assert np.median(np.abs(found.depth - compiled.depth)[seen]) < 0.004


def test_the_backend_follows_the_device() -> None:
    assert backend_of(torch.device("cpu")) is Backend.NUMBA
    assert backend_of(torch.device("meta")) is Backend.TORCH
    assert backend_of(torch.device("cuda")) in (Backend.TRITON, Backend.TORCH)
    assert pick(torch.zeros(1), compiled=len, plain=sum) is len
    assert pick(torch.zeros(1, device="meta"), compiled=len, plain=sum) is sum


def test_plain_torch_holds_in_every_thread_until_the_last_one_leaves() -> None:
    cpu = torch.device("cpu")
    with ThreadPoolExecutor(1) as pool:
        with plain_torch():
            with plain_torch():
                assert pool.submit(backend_of, cpu).result() is Backend.TORCH
            assert pool.submit(backend_of, cpu).result() is Backend.TORCH
        assert pool.submit(backend_of, cpu).result() is Backend.NUMBA
