"""Ctrl-C as a request to stop at a moment at which nothing is lost."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def stop_on_interrupt(*others: signal.Signals) -> Iterator[threading.Event]:
    """Gives an event that the first Ctrl-C (SIGINT), or one of the `others`, sets. The next Ctrl-C interrupts the program as usual.

    Python delivers signals to the main thread only: in any other thread the handlers stay as they are and the event is never set.
    """
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    usual = {number: signal.getsignal(number) for number in (signal.SIGINT, *others)}

    def on_signal(number: int, frame: FrameType | None) -> None:
        stop.set()
        signal.signal(signal.SIGINT, usual[signal.SIGINT])

    for number in usual:
        signal.signal(number, on_signal)
    try:
        yield stop
    finally:
        for number, handler in usual.items():
            signal.signal(number, handler)
