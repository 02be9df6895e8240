"""Work on the next item while the present one is used."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def ahead(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """`map`, in a thread of its own, which works on one item while the result of the one before it is used.

    It pays where the function and its user release the interpreter, as decoders and compiled loops do. The thread ends with the iteration.
    Only one of the function and its user runs parallel loops of Numba: where its own threading layer is the only one, those of two threads
    may not overlap.
    """
    with ThreadPoolExecutor(1, "ahead") as pool:
        following: Future[Result] | None = None
        for item in items:
            present, following = following, pool.submit(function, item)
            if present is not None:
                yield present.result()
        if following is not None:
            yield following.result()
