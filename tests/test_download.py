"""Downloads from a server of the tests' own: cut off and taken up again, wrong, missing, in the way, and archives that mean harm."""

import errno
import hashlib
import io
import json
import os
import re
import tarfile
import threading
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from helpers.recordings import write_folder, write_seven_scenes
from idfslam.cli import command_line
from idfslam.datasets import open_recording
from idfslam.datasets.readers.tum import BONN, published
from idfslam.downloads import catalogue as module
from idfslam.downloads.catalogue import Sequence, catalogue, find_sequence
from idfslam.downloads.download import LEDGER, download
from idfslam.downloads.fetch import fetch
from idfslam.errors import ArchiveError, DownloadError
from idfslam.storage.unpack import unpack

CONTENT = bytes(range(256)) * 4000  # about 1 MB


class Server(ThreadingHTTPServer):
    """Serves `content` with Range and If-Range; `cuts` says after how many bytes each of the next answers breaks off."""

    content = CONTENT
    tag: str | None = '"one"'
    knows_ranges = True
    status = 200

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.cuts: list[int] = []
        self.ranges: list[str | None] = []  # of each request

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/a.tgz"


class Handler(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        server, asked = self.server, self.headers["Range"]
        server.ranges.append(asked)
        if server.status != 200:
            self.send_error(server.status)
            return
        start = 0
        if asked and server.knows_ranges and self.headers["If-Range"] == server.tag:
            start = int(re.fullmatch(r"bytes=(\d+)-", asked)[1])  # type: ignore[index]
        size = len(server.content)
        self.send_response(206 if start else 200)
        self.send_header("Content-Length", str(size - start))
        if start:
            self.send_header("Content-Range", f"bytes {start}-{size - 1}/{size}")
        if server.tag:
            self.send_header("ETag", server.tag)
        self.end_headers()
        self.wfile.write(server.content[start:][: server.cuts.pop(0) if server.cuts else None])

    def log_message(self, format: str, *args: object) -> None: ...


@pytest.fixture
def server() -> Iterator[Server]:
    with Server() as serving:
        thread = threading.Thread(target=serving.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield serving
        serving.shutdown()
        thread.join()


def archive_of(folder: Path) -> bytes:
    """A .tgz of a folder, with its name."""
    data = io.BytesIO()
    with tarfile.open(fileobj=data, mode="w:gz") as tar:
        tar.add(folder, folder.name)
    return data.getvalue()


@pytest.fixture
def sequence(server: Server, tmp_path: Path) -> Sequence:
    server.content = archive_of(write_folder(tmp_path / "source" / "room"))
    return Sequence("a-room", server.url, "room", "free")


def listed(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_file_comes_whole(server: Server, tmp_path: Path) -> None:
    reports: list[tuple[int, int | None]] = []
    fetch(server.url, tmp_path / "a", report=lambda *figures: reports.append(figures))
    assert (tmp_path / "a").read_bytes() == CONTENT
    assert reports[-1] == (len(CONTENT), len(CONTENT))


def test_a_connection_that_is_cut_is_taken_up_again(server: Server, tmp_path: Path) -> None:
    server.cuts = [300_000, 500_000]
    fetch(server.url, tmp_path / "a", pause=0.01)
    assert (tmp_path / "a").read_bytes() == CONTENT
    assert server.ranges == [None, "bytes=300000-", "bytes=800000-"]


def test_a_later_call_goes_on(server: Server, tmp_path: Path) -> None:
    server.cuts = [300_000, 0, 0, 0]
    with pytest.raises(DownloadError, match="cut off after 300000 of 1024000 bytes; what was fetched so far is kept"):
        fetch(server.url, tmp_path / "a", pause=0.01)
    assert (tmp_path / "a").stat().st_size == 300_000
    server.ranges.clear()
    fetch(server.url, tmp_path / "a")
    assert (tmp_path / "a").read_bytes() == CONTENT
    assert server.ranges == ["bytes=300000-"]
    fetch(server.url, tmp_path / "a")
    assert len(server.ranges) == 1  # it was whole


@pytest.mark.parametrize("change", ["tag", "no ranges", "no tag"])
def test_it_begins_anew_where_the_rest_would_not_fit(server: Server, tmp_path: Path, change: str) -> None:
    server.cuts = [300_000, 0, 0, 0]
    if change == "no tag":
        server.tag = None
    with pytest.raises(DownloadError):
        fetch(server.url, tmp_path / "a", pause=0.01)
    server.content = CONTENT[::-1]
    if change == "tag":
        server.tag = '"two"'
    server.knows_ranges = change != "no ranges"
    server.cuts = []
    fetch(server.url, tmp_path / "a")
    assert (tmp_path / "a").read_bytes() == CONTENT[::-1]


def test_what_the_server_says_is_told(server: Server, tmp_path: Path) -> None:
    server.status = 404
    with pytest.raises(DownloadError, match=r"a\.tgz: the server says 404 Not Found: has it moved\?"):
        fetch(server.url, tmp_path / "a")
    assert len(server.ranges) == 1
    server.status = 503
    with pytest.raises(DownloadError, match="503 Service Unavailable"):
        fetch(server.url, tmp_path / "a", pause=0.01)
    assert len(server.ranges) == 4
    with pytest.raises(DownloadError, match="refused"):
        fetch("http://127.0.0.1:9/a.tgz", tmp_path / "a", pause=0.01)


def test_a_full_disk_keeps_what_there_is(server: Server, tmp_path: Path) -> None:
    def full(done: int, total: int | None) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(DownloadError, match="No space left on device; what was fetched so far is kept"):
        fetch(server.url, tmp_path / "a", report=full)
    assert (tmp_path / "a").stat().st_size > 0
    fetch(server.url, tmp_path / "a")
    assert (tmp_path / "a").read_bytes() == CONTENT


def test_a_sequence_is_a_recording(sequence: Sequence, tmp_path: Path) -> None:
    out = tmp_path / "data"
    folder = download(sequence, out)
    assert folder == out / "room"
    assert len(open_recording(folder)) == 3
    assert listed(out) == [LEDGER, "room"]
    entry = json.loads((out / LEDGER).read_text())["a-room"]
    assert entry["url"] == sequence.url
    assert entry["licence"] == "free"
    assert len(entry["sha256"]) == 64


def test_what_is_there_is_not_fetched_again(sequence: Sequence, server: Server, tmp_path: Path) -> None:
    download(sequence, tmp_path / "data")
    server.ranges.clear()
    assert download(sequence, tmp_path / "data") == tmp_path / "data" / "room"
    assert server.ranges == []


def test_a_folder_in_the_way_is_left_alone(sequence: Sequence, server: Server, tmp_path: Path) -> None:
    (tmp_path / "data" / "room").mkdir(parents=True)
    (tmp_path / "data" / "room" / "mine.txt").write_text("mine")
    with pytest.raises(DownloadError, match="is there already, and not from this command"):
        download(sequence, tmp_path / "data")
    assert listed(tmp_path / "data" / "room") == ["mine.txt"]
    assert server.ranges == []


def test_a_wrong_hash_is_refused(sequence: Sequence, server: Server, tmp_path: Path) -> None:
    digest = hashlib.sha256(server.content).hexdigest()
    right = Sequence("a-room", server.url, "room", "free", sha256=digest)
    wrong = Sequence("a-room", server.url, "room", "free", sha256="0" * 64)
    with pytest.raises(DownloadError, match=rf"sha256 {digest}, expected 0{{64}} \(published\): try again"):
        download(wrong, tmp_path / "data")
    assert listed(tmp_path / "data") == []
    assert (download(right, tmp_path / "data") / "rgb").is_dir()


def test_later_downloads_are_held_to_the_first(sequence: Sequence, server: Server, tmp_path: Path) -> None:
    out = tmp_path / "data"
    (download(sequence, out)).rename(out / "elsewhere")
    first = server.content
    server.content = archive_of(write_folder(tmp_path / "other" / "room", frames=2))
    with pytest.raises(DownloadError, match=r"\(of the first download\): if it was published anew"):
        download(sequence, out)
    assert not (out / "room").exists()
    server.content = first
    assert len(open_recording(download(sequence, out))) == 3


def test_a_damaged_archive_leaves_nothing(sequence: Sequence, server: Server, tmp_path: Path) -> None:
    server.content = server.content[:-200]
    with pytest.raises(DownloadError, match="damaged"):
        download(sequence, tmp_path / "data")
    assert listed(tmp_path / "data") == []


def write_tar(path: Path, *members: tarfile.TarInfo) -> Path:
    with tarfile.open(path, "w") as tar:
        for member in members:
            member.size = 4 if member.isreg() else 0
            tar.addfile(member, io.BytesIO(b"evil"))
    return path


def special(name: str, kind: bytes, target: str = "") -> tarfile.TarInfo:
    member = tarfile.TarInfo(name)
    member.type, member.linkname = kind, target
    return member


@pytest.mark.parametrize("name", ["../outside.txt", "/tmp/outside.txt", "a/../../outside.txt", "..\\outside.txt"])
@pytest.mark.parametrize("form", ["tar", "zip"])
def test_nothing_lands_outside(tmp_path: Path, name: str, form: str) -> None:
    archive = tmp_path / "in" / f"a.{form}"
    archive.parent.mkdir()
    if form == "tar":
        write_tar(archive, tarfile.TarInfo("good.txt"), tarfile.TarInfo(name))
    else:
        with zipfile.ZipFile(archive, "w") as opened:
            opened.writestr("good.txt", "good")
            info = zipfile.ZipInfo("x")
            info.filename = name  # as it stands: the constructor would tidy it up
            opened.writestr(info, "evil")
    with pytest.raises(ArchiveError, match="expected files and folders inside it"):
        unpack(archive, tmp_path / "folder")
    assert not list(tmp_path.rglob("*outside*"))
    assert not Path("/tmp/outside.txt").exists()


def test_links_are_left_out_and_lead_nowhere(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    members = (special("a", tarfile.SYMTYPE, str(outside)), tarfile.TarInfo("a/file.txt"), special("b", tarfile.LNKTYPE, "../x"))
    unpack(write_tar(tmp_path / "a.tar", *members), tmp_path / "folder")
    assert listed(outside) == []
    assert listed(tmp_path / "folder") == ["a"]
    assert (tmp_path / "folder" / "a" / "file.txt").read_bytes() == b"evil"
    assert "the link 'a' is left out" in caplog.text


def test_devices_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ArchiveError, match=r"'b' \(device\)"):
        unpack(write_tar(tmp_path / "a.tar", special("b", tarfile.CHRTYPE)), tmp_path / "folder")


def test_a_scene_of_zips_in_a_zip(server: Server, tmp_path: Path) -> None:
    scene = write_seven_scenes(_made(tmp_path / "source" / "seq-01"))
    inner, outer = io.BytesIO(), io.BytesIO()
    with zipfile.ZipFile(inner, "w") as opened:
        opened.writestr("seq-01/Thumbs.db", "junk")
        for path in scene.iterdir():
            opened.write(path, f"seq-01/{path.name}")
    with zipfile.ZipFile(outer, "w") as opened:
        opened.writestr("chess/seq-01.zip", inner.getvalue())
        opened.writestr("chess/TrainSplit.txt", "sequence1")
    server.content = outer.getvalue()
    folder = download(Sequence("chess", server.url, "7scenes/chess", "free", run=("seq-01",)), tmp_path / "data")
    assert listed(folder) == ["TrainSplit.txt", "seq-01"]
    assert "Thumbs.db" not in listed(folder / "seq-01")
    assert len(open_recording(folder / "seq-01")) == 3


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder


def test_the_catalogue() -> None:
    known = catalogue()
    assert {"tum-fr1-desk", "7scenes-chess", "icl-living-room-0", "replica"} <= known.keys()
    assert len({sequence.folder for sequence in known.values()}) == len(known)
    assert all(sequence.url.startswith("https://") and sequence.licence for sequence in known.values())
    assert "freiburg1" in known["tum-fr1-desk"].folder  # by which the reader knows the camera
    assert known["tum-fr3-walking-xyz"].url.endswith("/freiburg3/rgbd_dataset_freiburg3_walking_xyz.tgz")
    assert published(Path("/data") / known["bonn-crowd2"].folder) == replace(BONN, source=published(Path("rgbd_bonn_x")).source)
    with pytest.raises(DownloadError, match="fr1: not a known sequence, expected one such as tum-fr1-desk"):
        find_sequence("fr1")


def test_the_command(sequence: Sequence, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(module, "catalogue", lambda: {"a-room": sequence})
    command_line.main(["download", "a-room", "--out", str(tmp_path / "data")])
    printed = capsys.readouterr()
    assert printed.out == f"idf-slam run {tmp_path / 'data' / 'room'}\n"
    assert "free" in printed.err
    monkeypatch.undo()
    command_line.main(["download", "--list"])
    assert "tum-fr1-desk" in capsys.readouterr().out
    for arguments, message in ((["download"], "expected the name of a sequence"), (["download", "nothing"], "not a known sequence")):
        with pytest.raises(SystemExit) as caught:
            command_line.main(arguments)
        assert caught.value.code == 1
        assert message in capsys.readouterr().err
