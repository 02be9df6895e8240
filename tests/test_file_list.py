"""Lists of stamped images, as people's programs write them: each gives the same recording as the plain one."""

from collections.abc import Callable
from pathlib import Path

import pytest

from helpers.recordings import write_tum
from idfslam.datasets import open_recording
from idfslam.errors import RecordingError


def both(path: Path, change: Callable[[str], str]) -> None:
    for name in ("rgb.txt", "depth.txt"):
        (path / name).write_bytes(change((path / name).read_text()).encode())


def in_unit(text: str, units: float) -> str:
    rows = [line.split() for line in text.splitlines() if not line.startswith("#")]
    return "".join(f"{float(stamp) * units:.0f} {file}\n" for stamp, file in rows)


def moved(text: str) -> str:
    """Absolute paths of another machine, with Windows' separators."""
    return text.replace(" rgb/", r" C:\Users\me\room\rgb" + "\\").replace(" depth/", " /home/me/room/depth/")


FORMS: dict[str, Callable[[str], str]] = {
    "CRLF": lambda text: text.replace("\n", "\r\n"),
    "trailing spaces": lambda text: text.replace("\n", "  \n"),
    "BOM": lambda text: "\ufeff" + text,
    "commas": lambda text: text.replace(" ", ","),
    "tabs": lambda text: text.replace(" ", "\t"),
    "backslashes": lambda text: text.replace("/", "\\"),
    "header": lambda text: "timestamp filename\n" + text,
    "three columns": lambda text: text.replace(".png\n", ".png extra\n"),
    "unsorted": lambda text: "\n".join(reversed(text.splitlines())),
    "each line twice": lambda text: text + text,
    "moved": moved,
}


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_the_lists(form: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_tum(tmp_path / "room")
    both(path, FORMS[form])
    recording = open_recording(path)
    assert recording.timestamps == pytest.approx([100, 100.033333, 100.066667])
    assert len(caplog.messages) == (2 if form == "unsorted" else 0)  # one for each list
    assert [round(float(recording[i].colour[0, 0, 0]) * 255) for i in range(3)] == [10, 11, 12]
    assert recording.ground_truth is not None


@pytest.mark.parametrize(("units", "name"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
def test_stamps_in_other_units(units: float, name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_tum(tmp_path / "room", frames=4)
    both(path, lambda text: in_unit(text, units))
    assert open_recording(path).timestamps == pytest.approx([100, 100.033333, 100.066667, 100.1], abs=1e-3)
    assert [f"the stamps are taken for {name}" in message for message in caplog.messages] == [True]


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("100.5 rgb/absent.png", "rgb/absent.png does not exist"),
        ("100.5 ../../etc/passwd", "passwd is not the name of an image"),
        ("100.5 rgb/" + "x" * 5000 + ".png", "xxx.png does not exist"),
        ("100.5 rgb/a\0b.png", "does not exist"),
        ("nan rgb/100.000000.png", "line 5 is 'nan rgb/100.000000.png', expected a stamp in seconds and a file"),
        ("word", "line 5 is 'word'"),
    ],
)
def test_a_line_that_names_no_image_is_left_out(line: str, why: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_tum(tmp_path / "room")
    with (path / "rgb.txt").open("a") as file:
        file.write(line + "\n")
    assert len(open_recording(path)) == 3
    assert len(caplog.messages) == 1 and "rgb.txt: 1 image is left out: line 5" in caplog.messages[0] and why in caplog.messages[0]
    assert len(caplog.messages[0]) < 500


def test_many_missing_files_are_one_warning_and_all_of_them_one_error(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_tum(tmp_path / "room", frames=50)
    files = sorted((path / "depth").iterdir())
    for file in files[2:]:
        file.unlink()
    recording = open_recording(path)
    assert [recording[i].depth.any() for i in range(50)] == [True] * 3 + [False] * 47  # the third has the depth of the second
    assert [f"48 images are left out, the first because line 4: {files[2]} does not exist" in text for text in caplog.messages] == [
        True,
        False,
    ]
    for file in files[:2]:
        file.unlink()
    with pytest.raises(RecordingError, match=r"depth\.txt: line 2: .*100.000000.png does not exist"):
        open_recording(path)


@pytest.mark.parametrize("depth_first", [False, True])
def test_pairs_in_associations_txt(depth_first: bool, tmp_path: Path) -> None:
    path = write_tum(tmp_path / "room")
    rows = []
    for i in range(3):
        stamp = f"{100 + i / 30:.6f}"
        colour, depth = f"{stamp} rgb/{stamp}.png", f"{float(stamp) + 0.004:.6f} depth/{stamp}.png"
        rows.append(f"{depth} {colour}" if depth_first else f"{colour} {depth}")
    (path / "associations.txt").write_text("\n".join(rows))
    for name in ("rgb.txt", "depth.txt"):
        (path / name).unlink()
    recording = open_recording(path)
    assert recording.timestamps == pytest.approx([100, 100.033333, 100.066667])  # of the colour images
    assert round(float(recording[2].colour[0, 0, 0]) * 255) == 12
