"""The device of a run; settings that are torch's and Numba's for the whole process, or a thread of it."""

from threading import Event, Thread

import numba
import pytest
import torch

from idfslam.compute.devices import repeatable, resolve_device, threads
from idfslam.config import FAST, PAPER

CPU = torch.device("cpu")


def test_gradients_are_repeatable_until_the_last_thread_leaves() -> None:
    entered, leave = Event(), Event()

    def other() -> None:
        with repeatable(CPU):
            entered.set()
            leave.wait()

    thread = Thread(target=other)
    assert not torch.are_deterministic_algorithms_enabled()
    with repeatable(CPU):
        thread.start()
        entered.wait()
    assert torch.are_deterministic_algorithms_enabled()  # the other is still within
    leave.set()
    thread.join()
    assert not torch.are_deterministic_algorithms_enabled()


def test_a_share_of_the_threads_is_taken_and_given_back() -> None:
    before = numba.get_num_threads()
    with threads(0.5):
        assert numba.get_num_threads() == max(1, round(numba.config.NUMBA_NUM_THREADS / 2))
        with threads(1.0):
            assert numba.get_num_threads() == numba.config.NUMBA_NUM_THREADS
        assert numba.get_num_threads() == max(1, round(numba.config.NUMBA_NUM_THREADS / 2))
    assert numba.get_num_threads() == before


def test_auto_keeps_the_fast_preset_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert resolve_device("auto", FAST.preset).type == "cpu"
    assert resolve_device("auto", PAPER.preset).type == "cuda"
    assert resolve_device("auto").type == "cuda"  # pretraining
    assert resolve_device("cuda", FAST.preset).type == "cuda"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert resolve_device("auto", PAPER.preset).type == "cpu"
