"""A ROS 1 bag, a ROS 2 bag (sqlite3 or MCAP) or an MCAP file read with `rosbags`: messages by topic and time."""

import logging
import re
import struct
import threading
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from idfslam.errors import ConfigError, FrameError, RecordingError, pip_install

log = logging.getLogger(__name__)

SUFFIXES = frozenset({".bag", ".mcap", ".db3"})
# Errors besides its own that rosbags raises for damaged data: it trusts lengths and checks with assert
_TYPE_NAME = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*){1,2}", re.ASCII)  # sensor_msgs/Image, sensor_msgs/msg/Image
_DAMAGE = (AssertionError, EOFError, IndexError, KeyError, MemoryError, OverflowError, RuntimeError, TypeError, ValueError, struct.error)


@dataclass(frozen=True, order=True)
class IndexedMessage:
    """Stamp and position of one message."""

    stamp: float  # [s] of its header; of its arrival if it has none
    time: int  # [ns] of its arrival in the recording; `Bag.at` finds the message by it


class Bag:
    """An opened recording; threads may share it. Raises RecordingError if it cannot be read, ConfigError if rosbags is not installed."""

    def __init__(self, path: Path) -> None:
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise ConfigError(f"reading ROS bags and MCAP needs rosbags: {pip_install('rosbags')}") from error

        self.path, self._lock, self._errors = path, threading.Lock(), _errors()
        try:
            for part in AnyReader([path]).readers:
                _check_types(part)
            self._reader = AnyReader([path], default_typestore=get_typestore(Stores.LATEST))
            self._reader.open()
        except self._errors as error:
            hint = "rosbag reindex it or copy the recording again" if path.suffix == ".bag" else "copy the recording again"
            raise RecordingError(f"{path}: not a readable recording ({_line(error)}): {hint}") from error
        weakref.finalize(self, self._reader.close)
        self.types = {c.topic: c.msgtype.replace("/msg/", "/") for c in self._reader.connections if c.msgcount}

    def topics(self, *types: str) -> list[str]:
        """The topics with messages of any of these types, in alphabetical order."""
        return sorted(topic for topic, message_type in self.types.items() if message_type in types)

    def first(self, topic: str) -> Any:
        """The first message of a topic; raises RecordingError if it cannot be read."""
        for message in self.messages(topic):
            return message
        raise RecordingError(f"{self.path}: {topic} cannot be read (its messages are gone): copy the recording again")

    def messages(self, topic: str) -> Iterator[Any]:
        """All messages of a topic in their order; raises RecordingError if one cannot be read."""
        for _, _, message in self._each([topic]):
            yield message

    def index(self, *topics: str) -> dict[str, list[IndexedMessage]]:
        """All messages of some topics, sorted by their stamps. Reads every message once, because the stamps are in the messages."""
        log.info("%s: reading the stamps of %s", self.path, " and ".join(topics))
        entries: dict[str, list[IndexedMessage]] = {topic: [] for topic in topics}
        for topic, time, message in self._each(list(topics)):
            entries[topic].append(IndexedMessage(stamp_of(message) or time / 1e9, time))
        return {topic: sorted(messages) for topic, messages in entries.items()}

    def _each(self, topics: list[str]) -> Iterator[tuple[str, int, Any]]:
        connections = [connection for connection in self._reader.connections if connection.topic in topics]
        try:
            with self._lock:
                for connection, time, data in self._reader.messages(connections=connections):
                    yield connection.topic, time, self._reader.deserialize(data, connection.msgtype)
        except self._errors as error:
            raise RecordingError(f"{self.path}: {topics[0]} cannot be read ({_line(error)}): copy the recording again") from error

    def at(self, topic: str, entry: IndexedMessage) -> Any:
        """The message at an entry of the index; raises FrameError if it cannot be read."""
        connections = [connection for connection in self._reader.connections if connection.topic == topic]
        try:
            with self._lock:
                for connection, _, data in self._reader.messages(connections=connections, start=entry.time, stop=entry.time + 1):
                    message = self._reader.deserialize(data, connection.msgtype)
                    if (stamp_of(message) or entry.time / 1e9) == entry.stamp:
                        return message
            reason = "it is gone"
        except self._errors as error:
            reason = _line(error)
        raise FrameError(f"{self.path}: {topic} at {entry.stamp:.3f} s cannot be read ({reason}): copy the recording again")


def _errors() -> tuple[type[Exception], ...]:
    """All errors that rosbags and the packages it uses raise for damaged files."""
    import apsw
    from rosbags.highlevel import AnyReaderError
    from rosbags.rosbag1 import ReaderError as Error1
    from rosbags.rosbag2 import ReaderError as Error2

    try:
        from compression.zstd import ZstdError  # Python 3.14
    except ImportError:
        from backports.zstd import ZstdError
    return (AnyReaderError, Error1, Error2, apsw.Error, ZstdError, *_DAMAGE)


def _check_types(reader: Any) -> None:
    """Raises ValueError if a message type has an impossible name: rosbags puts the names into Python code that it runs.

    Its own opening does that at once, so the index is read before it, once more. Names within a definition are checked by its grammar.
    """
    reader.open()
    try:
        for connection in reader.connections:
            if not _TYPE_NAME.fullmatch(connection.msgtype):
                raise ValueError(f"a message type is named {connection.msgtype[:40]!r}")
    finally:
        reader.close()


def stamp_of(message: Any) -> float:
    """The stamp [s] in a message's header; 0 if it has none."""
    header = getattr(message, "header", None)
    return 0.0 if header is None else header.stamp.sec + header.stamp.nanosec / 1e9


def _line(error: Exception) -> str:
    words = str(error).splitlines()
    return f"{words[0].rstrip('.')}" if words else type(error).__name__
