"""Settings that hold for every test, and a small recording that many of them run on."""

# ruff: noqa: E402
from idfslam.compute.process import prepare_process
from idfslam.compute.torch_threads import limit_torch_threads

prepare_process()  # before torch or numba is imported
import numba

numba.get_num_threads()  # Numba starts its threads when it is first asked, and sets the number of torch's then
limit_torch_threads("grid")  # for all tests: a command that runs SLAM would do it for the tests after its own

import logging
from pathlib import Path

import pytest
from hypothesis import settings

from helpers.box_room import write_box_recording

settings.register_profile("suite", deadline=None, derandomize=True, max_examples=50)  # timings vary on a shared machine
settings.load_profile("suite")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Modules with slow tests come first: of two processes that share the modules, neither is left with a long one at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(autouse=True)
def logging_of_one_test() -> None:
    """A command sets how much the package logs, and where to. A test begins without what commands before it, or its fixtures, have set."""
    for logger in (logging.getLogger(), logging.getLogger("idfslam")):
        logger.handlers[:] = [handler for handler in logger.handlers if type(handler).__module__.startswith("_pytest")]
    logging.getLogger("idfslam").setLevel(logging.NOTSET)


@pytest.fixture(scope="session")
def box_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 14 frames, 160 x 120, with ground truth; not to be changed."""
    return write_box_recording(tmp_path_factory.mktemp("recordings") / "box")


@pytest.fixture(scope="session")
def known_run(box_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result folder of a run on that recording whose poses are the true ones; not to be changed."""
    from helpers.known_run import write_known_run

    return write_known_run(tmp_path_factory.mktemp("results") / "known", box_recording)
