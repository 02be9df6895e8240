"""Work on the next item while the present one is used."""

from threading import Event, current_thread
from threading import enumerate as threads
from typing import Any

import pytest

from idfslam.compute.ahead import ahead


def test_results_come_in_order_and_one_is_worked_out_meanwhile() -> None:
    begun = [Event() for _ in range(4)]

    def square(i: int) -> int:
        begun[i].set()
        return i * i

    found = []
    for i, value in enumerate(ahead(square, range(4))):
        assert begun[min(i + 1, 3)].wait(10)  # the next one has begun though this one is still in use
        found.append(value)
    assert found == [0, 1, 4, 9]
    assert list(ahead(square, [])) == []


def test_an_error_reaches_the_user_at_its_item_and_the_thread_ends() -> None:
    def inverse(x: int) -> float:
        return 1 / x

    results = ahead(inverse, [2, 0, 4])
    assert next(results) == 0.5
    with pytest.raises(ZeroDivisionError):
        next(results)
    assert not [thread for thread in threads() if thread.name.startswith("ahead")]


def test_the_thread_ends_when_the_user_stops() -> None:
    names: list[Any] = []
    results = ahead(lambda _: names.append(current_thread().name), range(100))
    next(results)
    results.close()  # type: ignore[attr-defined]
    assert not [thread for thread in threads() if thread.name in names]
    assert len(names) <= 3
