"""Downloads of files over HTTP that resume after an interruption (RFC 9110, Sec. 14: Range, If-Range)."""

import http.client
import json
import logging
import re
import ssl
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.request import Request, urlopen

from idfslam import __version__
from idfslam.errors import DownloadError
from idfslam.storage.json_file import read_json

log = logging.getLogger(__name__)

Report = Callable[[int, int | None], None]  # bytes so far, total bytes if known

_TIMEOUT = 30.0  # [s] without data before a connection counts as lost; raised, slow servers are tolerated. Chosen by hand
_ATTEMPTS = 3  # attempts in a row without new data, after which the download fails. Chosen by hand
_PAUSE = 1.0  # [s] before the next attempt, multiplied by their number; raised, outages may last longer. Chosen by hand
_BLOCK = 1 << 18  # [bytes] read at once; raised, progress is reported less often


def fetch(url: str, path: Path, *, report: Report = lambda done, total: None, pause: float = _PAUSE) -> None:
    """Downloads the file at `url` to `path`, which may hold the beginning of it from an earlier call; `path`.json identifies that file.

    A lost connection is resumed. Raises DownloadError if the server refuses, no more data comes or the disk is full; `path` then keeps the
    data so far and the next call resumes it.
    """
    failures = 0
    while True:
        before = _size(path)
        try:
            _attempt(url, path, report)
        except HTTPError as error:
            if error.code < 500:
                raise DownloadError(f"{url}: the server says {error.code} {error.reason}: has it moved?") from error
            why = f"{error.code} {error.reason}"
        except (URLError, ConnectionError, TimeoutError, ssl.SSLError, http.client.HTTPException) as error:
            why = str(getattr(error, "reason", error) or type(error).__name__)
        except OSError as error:
            raise DownloadError(
                f"{path}: {error.strerror}; what was fetched so far is kept, the same command goes on from there"
            ) from error
        else:
            return
        failures = 0 if _size(path) > before else failures + 1
        if failures == _ATTEMPTS:
            raise DownloadError(f"{url}: {why}; what was fetched so far is kept, the same command goes on from there")
        log.warning("%s: %s; trying again", url, why)
        time.sleep(pause * (failures + 1))


def discard(path: Path) -> None:
    """Removes the files of an unfinished `fetch`."""
    path.unlink(missing_ok=True)
    _state_file(path).unlink(missing_ok=True)


def _attempt(url: str, path: Path, report: Report) -> None:
    """Requests the missing bytes once. Raises ConnectionError if fewer bytes come than the server announced."""
    state, start = _read_state(path, url), _size(path)
    if start and start == state.get("total"):
        return
    headers = {"User-Agent": f"idf-slam/{__version__}", "Accept-Encoding": "identity"}
    if start and state.get("version"):
        headers |= {"Range": f"bytes={start}-", "If-Range": state["version"]}
    with urlopen(Request(url, headers=headers), timeout=_TIMEOUT) as response:
        resumed = response.status == 206 and (response.headers["Content-Range"] or "").startswith(f"bytes {start}-")
        if response.status == 206 and not resumed:
            discard(path)
            raise ConnectionError(f"asked for bytes from {start} on, got {response.headers['Content-Range']}")
        done, total = (start if resumed else 0), _total(response, resumed)
        if not resumed:
            path.unlink(missing_ok=True)  # before its state changes, so that bytes of two versions are never joined
            _state_file(path).write_text(json.dumps({"url": url, "version": _version(response), "total": total}), encoding="utf-8")
        with path.open("ab") as file:
            while block := response.read(_BLOCK):
                file.write(block)
                done += len(block)
                report(done, total)
    if total is not None and done != total:
        raise ConnectionError(f"cut off after {done} of {total} bytes")


def _total(response: Any, resumed: bool) -> int | None:
    """The size of the whole file [bytes], if the server gives it."""
    size = (
        re.search(r"/(\d+)$", response.headers["Content-Range"])
        if resumed
        else re.fullmatch(r"(\d+)", response.headers["Content-Length"] or "")
    )
    return int(size[1]) if size else None


def _version(response: Any) -> str | None:
    """An identifier of the file's version: a strong ETag, else the date."""
    tag: str | None = response.headers["ETag"]
    return tag if tag and not tag.startswith("W/") else response.headers["Last-Modified"]


def _read_state(path: Path, url: str) -> dict[str, Any]:
    try:
        state = read_json(_state_file(path), error=DownloadError, expected="the state of a download")
    except DownloadError:
        return {}
    return state if isinstance(state, dict) and state.get("url") == url else {}


def _state_file(path: Path) -> Path:
    return path.with_name(path.name + ".json")


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0
