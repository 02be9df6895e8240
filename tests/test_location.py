"""What a user names instead of the recording itself: archives, folders around it, parts of it, addresses."""

import logging
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from helpers.recordings import write_folder, write_sens, write_tum
from idfslam.datasets import open_recording
from idfslam.datasets.location import locate, without_scheme
from idfslam.errors import RecordingError


@pytest.mark.parametrize("form", ["zip", "tar", "gztar", "bztar", "xztar"])
@pytest.mark.parametrize("inside", ["files", "a folder"])
def test_archives(form: str, inside: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_folder(tmp_path / "scans/kitchen")
    root = tmp_path / ("scans/kitchen" if inside == "files" else "scans")
    archive = shutil.make_archive(str(tmp_path / "Evening.Scan"), form, root)
    recording = open_recording(archive)
    assert len(recording) == 3 and recording[2].index == 2
    assert recording.name == ("Evening.Scan" if inside == "files" else "kitchen")
    assert "an archive, unpacked to" in caplog.text and "until the program ends" in caplog.text


def test_what_an_archive_was_unpacked_to_is_removed(tmp_path: Path) -> None:
    write_folder(tmp_path / "kitchen")
    archive = shutil.make_archive(str(tmp_path / "kitchen"), "zip", tmp_path / "kitchen")
    (tmp_path / "temporary").mkdir()
    program = f"""
import tempfile; tempfile.tempdir = {str(tmp_path / "temporary")!r}
from pathlib import Path
from idfslam.datasets import open_recording
for _ in range(2):
    assert len(open_recording({archive!r})) == 3
assert len(list(Path(tempfile.tempdir).iterdir())) == 1
"""
    subprocess.run([sys.executable, "-c", program], check=True)
    assert not list((tmp_path / "temporary").iterdir())


def test_an_archive_made_to_fill_the_disk_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("idfslam.storage.unpack._ALWAYS", 1 << 20)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("rgb/0.png", bytes(50 << 20))
    with pytest.raises(RecordingError, match=r"bomb\.zip: unpacks to more than a recording of its size can hold: nothing of it is used"):
        open_recording(tmp_path / "bomb.zip")
    assert not list((tmp_path / "temporary").iterdir())


@pytest.mark.parametrize(
    ("name", "message"),
    [("damaged.zip", "damaged"), ("damaged.tar.gz", "damaged"), ("encrypted.zip", "encrypted"), ("method.zip", "method")],
)
def test_archives_that_cannot_be_read(name: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if name.startswith("damaged"):
        path.write_bytes(b"PK or not")
    else:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("rgb/0.png", b"data")
        data, central = bytearray(path.read_bytes()), path.read_bytes().index(b"PK\1\2")
        for header, at in ((0, 6), (central, 8)):  # flags, followed by the method
            data[header + at + (2 if name == "method.zip" else 0)] = 99 if name == "method.zip" else 1
        path.write_bytes(data)
    with pytest.raises(RecordingError, match=message) as caught:
        open_recording(path)
    assert "\n" not in str(caught.value) and str(caught.value).startswith(str(path))


def test_nothing_of_an_archive_lands_outside(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("../../outside.txt", b"")
    with pytest.raises(RecordingError, match="expected files and folders inside it: nothing of it is used"):
        open_recording(tmp_path / "a.zip")


def test_a_folder_around_the_recording(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_folder(tmp_path / "outer/export/scan1")
    (tmp_path / "outer/notes").mkdir()
    assert open_recording(tmp_path / "outer/export").name == "scan1"
    assert "the recording in it, scan1, is read" in caplog.text
    assert open_recording(tmp_path / "outer").name == "scan1"
    write_tum(tmp_path / "outer/export/scan2")
    with pytest.raises(RecordingError, match=r"export: holds 2 recordings \(scan1, scan2\), expected one: name .*export/scan1"):
        open_recording(tmp_path / "outer/export")
    assert open_recording(tmp_path / "outer/export", format="tum").name == "scan2"


@pytest.mark.parametrize("part", ["rgb", "depth/", "intrinsics.txt", "rgb/000001.jpg", "pose"])
def test_a_part_of_the_recording(part: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_folder(tmp_path / "kitchen")
    with caplog.at_level(logging.WARNING):
        recording = open_recording(tmp_path / "kitchen" / part)
    assert recording.name == "kitchen" and len(recording) == 3
    assert f"a part of the recording {tmp_path / 'kitchen'}, which is read" in caplog.text


def test_results_of_earlier_runs_in_the_recording_do_not_matter(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "kitchen")
    (path / "results/depth_run").mkdir(parents=True)  # `idf-slam run .`
    assert len(open_recording(path)) == 3


def test_an_empty_folder_is_no_part_of_a_recording(tmp_path: Path) -> None:
    empty = write_folder(tmp_path / "kitchen") / "empty"
    empty.mkdir()
    with pytest.raises(RecordingError, match=r"kitchen/empty: not a known recording: found an empty folder"):
        open_recording(empty)


def test_what_lies_beside_a_recording_of_one_file_is_no_part_of_it(tmp_path: Path) -> None:
    """Otherwise a folder that lacks its depth is taken for the neighbour, which is another room."""
    write_sens(tmp_path / "hall.sens")
    shutil.rmtree(write_folder(tmp_path / "kitchen") / "depth")
    with pytest.raises(RecordingError, match=r"kitchen: .*depth"):
        open_recording(tmp_path / "kitchen")
    assert open_recording(tmp_path).name == "hall"


def test_a_list_of_a_tum_sequence(tmp_path: Path) -> None:
    write_tum(tmp_path / "desk")
    assert open_recording(tmp_path / "desk/rgb.txt").name == "desk"


def test_addresses_and_ways_to_write_a_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_folder(tmp_path / "Küche 1")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(path)
    for name in (
        f"{path}/",
        f"{path}/../Küche 1",
        ".",
        "~/Küche 1",
        f"file://{path}",
        f"file:{path}",
        f"file://localhost{path}",
        path.as_uri(),
    ):
        assert open_recording(name).name == "Küche 1"
    np.testing.assert_equal(without_scheme(Path("file:///a/b")), "/a/b")
    assert without_scheme("a/file:/b") == "a/file:/b"


def test_the_only_archive_in_a_folder_is_read(tmp_path: Path) -> None:
    write_folder(tmp_path / "kitchen")
    (tmp_path / "downloads").mkdir()
    shutil.make_archive(str(tmp_path / "downloads/kitchen"), "zip", tmp_path / "kitchen")
    (tmp_path / "downloads/readme.txt").write_text("a scan")
    assert len(open_recording(tmp_path / "downloads")) == 3


def test_a_locked_folder_beside_the_recording_does_not_matter(tmp_path: Path) -> None:
    write_folder(tmp_path / "scans/kitchen")

    def recognise(folder: Path) -> str | None:
        if folder.name == "locked":
            raise PermissionError(13, "Permission denied", str(folder / "color"))
        return "folder" if (folder / "rgb").is_dir() else None

    (tmp_path / "scans/locked").mkdir()
    assert locate(tmp_path / "scans", recognise, recognise) == (tmp_path / "scans/kitchen", "folder")


@pytest.mark.parametrize("path", ["", " "])
def test_an_empty_path_is_not_the_current_folder(path: str) -> None:
    with pytest.raises(RecordingError, match="the path of the recording is empty, expected a recording"):
        open_recording(path)


def test_strides_that_are_longer_than_any_recording(tmp_path: Path) -> None:
    assert len(open_recording(write_folder(tmp_path / "kitchen"), stride=10**30)) == 1
