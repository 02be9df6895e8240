"""Downloads a public sequence: the archive is fetched, checked by its hash, unpacked into a temporary folder and moved into place."""

import os
import shutil
import time
from pathlib import Path
from typing import Any

from idfslam.downloads.catalogue import Sequence
from idfslam.downloads.fetch import Report, discard, fetch
from idfslam.errors import ArchiveError, DownloadError
from idfslam.storage import atomic_files
from idfslam.storage.json_file import read_json
from idfslam.storage.sha256 import sha256
from idfslam.storage.unpack import unpack

LEDGER = "downloads.json"  # in the folder of downloads: when each sequence was downloaded, and the hash of its archive


def download(sequence: Sequence, out: Path, *, report: Report = lambda done, total: None) -> Path:
    """Downloads a sequence into a folder in `out`, unless an earlier call did; returns the folder.

    The archive must have the published hash or, without one, the hash of its first download. Raises DownloadError; the next call resumes an
    interrupted download.
    """
    folder, ledger = out / sequence.folder, read_ledger(out)
    if folder.exists():
        if sequence.name in ledger:
            return folder
        raise DownloadError(f"{folder}: is there already, and not from this command: move it away, or choose another folder with --out")
    atomic_files.prepare(out)
    archive = out / f".part-{sequence.name}"
    fetch(sequence.url, archive, report=report)
    digest = sha256(archive)
    _check(sequence, digest, ledger, archive, out)
    staging = out / f".part-{sequence.name}-unpacked"
    shutil.rmtree(staging, ignore_errors=True)
    try:
        unpack(archive, staging)
        ledger[sequence.name] = {
            "url": sequence.url,
            "bytes": archive.stat().st_size,
            "sha256": digest,
            "date": time.strftime("%Y-%m-%d"),
            "licence": sequence.licence,
        }
        atomic_files.write_json(out / LEDGER, ledger)
        folder.parent.mkdir(parents=True, exist_ok=True)
        os.replace(_root(staging), folder)
    except ArchiveError as error:
        if "damaged" in str(error):
            discard(archive)
        raise DownloadError(f"{error}: download it again") from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    discard(archive)
    return folder


def read_ledger(out: Path) -> dict[str, Any]:
    """The records of earlier downloads into the folder, by name. Raises DownloadError if the file is damaged."""
    path = out / LEDGER
    if not path.is_file():
        return {}
    try:
        ledger: dict[str, Any] = read_json(path, error=DownloadError, expected="a record that `idf-slam download` wrote: remove it")
        {entry["sha256"] for entry in ledger.values()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DownloadError(f"{path}: not as `idf-slam download` writes it ({error}): remove it") from error
    return ledger


def _check(sequence: Sequence, digest: str, ledger: dict[str, Any], archive: Path, out: Path) -> None:
    """Deletes the archive and raises DownloadError if its hash is not the expected one."""
    expected = sequence.sha256 or ledger.get(sequence.name, {}).get("sha256", digest)
    if digest == expected:
        return
    discard(archive)
    origin = "published" if sequence.sha256 else "of the first download"
    advice = "try again" if sequence.sha256 else f"if it was published anew, remove it from {out / LEDGER} and try again"
    raise DownloadError(f"{sequence.url}: sha256 {digest}, expected {expected} ({origin}): {advice}")


def _root(staging: Path) -> Path:
    """The only folder of the archive, or the whole archive if it has other entries."""
    entries = list(staging.iterdir())
    return entries[0] if len(entries) == 1 and entries[0].is_dir() else staging
