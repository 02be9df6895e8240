"""A pinhole camera as text, in the forms in which programs write it and people type it.

A matrix K of 3x3, 3x4 or 4x4, by rows or by columns; `fx fy cx cy` with or without distortion and image size; `fx: 525` as in ORB-SLAM's
files; `camera_matrix: data: [...]` as ROS and OpenCV write it; a line of COLMAP's cameras.txt. Brackets, commas and semicolons separate;
a comma may also be the decimal point. `#`, `%` and `//` start comments.
"""

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.errors import RecordingError

DISTORTION_LENGTHS = (4, 5, 8)  # numbers of OpenCV's distortion models that are read: a fact of OpenCV
MAX_SKEW = 1e-3  # [1] of fx; what a calibration leaves of rounding. Raised, more slanted pixels pass. 1e-3 moves an image's edge by 0.3 px
# Names for the units of depth images per metre, or metres per unit: see `units_per_metre`
DEPTH_SCALES = (
    *("depth_scale", "depthscale", "depth_factor", "depthfactor", "depthmapfactor", "depth_units"),
    *("png_depth_scale", "integer_depth_scale"),
)
_METRES_PER_UNIT = 0.1  # depth scales below are metres per unit, as RealSense's SDK gives them; raised, units of 10 m and more are refused
_EXACT = 1e-6  # [1] to which the zeros and the one of a matrix must hold; raised, more matrices pass. Chosen by hand
_EXPECTED = "expected a 3x3 matrix or one line of fx fy cx cy [k1 k2 p1 p2 [k3 [k4 k5 k6]]]"

_COMMENT = re.compile(r"(#|%|//).*")
_BRACKETS = re.compile(r"[\[\](){}|\"']")
_NUMBER = r"[-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][-+]?\d+)?"
_DECIMAL_COMMA = re.compile(r"[-+]?\d+(?:,\d+)?(?:[eE][-+]?\d+)?")
_KEYS = {
    **{name: name for name in ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "width", "height")},
    "fl_x": "fx",
    "fl_y": "fy",
    "ppx": "cx",
    "ppy": "cy",
    "image_width": "width",
    "image_height": "height",
    **{name: "scale" for name in ("scale", *DEPTH_SCALES)},
    "focal_length": "f",
    "f": "f",
}
_KEYED = re.compile(rf"(?<![\w])({'|'.join(_KEYS)})[\"']?(?:\s*[:=]\s*|[ \t]+)({_NUMBER})", re.IGNORECASE)
_MATRIX = re.compile(r"(?<!\w)(?:camera_?matrix|intrinsic_?matrix|(?-i:K)(?=\s*[:=]))(?!\w)[^\[]{0,200}(?=\[)", re.IGNORECASE)
_COEFFICIENTS = re.compile(
    r"(?<!\w)(?:distortion_?coefficients|dist_?coeffs|(?-i:D)(?=\s*[:=]))(?!\w)[^\[]{0,200}\[([^\]]{0,1000})\]", re.IGNORECASE
)
_FISHEYE = re.compile(r"equidistant|fisheye|kannala", re.IGNORECASE)
_COLMAP = re.compile(r"^[ \t]*\d+[ \t]+([A-Z][A-Z_]+)[ \t]+(\d{1,9})[ \t]+(\d{1,9})[ \t]+(.+)$", re.MULTILINE)
_LABEL = re.compile(r"^\s*[A-Za-z]\w*\s*[:=]")
_NAME = re.compile(r"[^\d\W]\w*")
_COLMAP_MODELS = {  # the places of fx fy cx cy, and those of the distortion values k1 k2 p1 p2 k3 k4 k5 k6 (None: 0)
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), ()),
    "PINHOLE": ((0, 1, 2, 3), ()),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3, None, None, None)),
    "RADIAL": ((0, 0, 1, 2), (3, 4, None, None)),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7)),
    "FULL_OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7, 8, 9, 10, 11)),
}


def parse_camera(text: str, source: str) -> Calibration:
    """The camera that a text states; `source` names it in messages and in the result. Raises RecordingError."""
    try:
        return _parsed(text, source)
    except (ValueError, OverflowError) as error:  # numbers that are too long or too large
        raise RecordingError(f"{source}: {error}, {_EXPECTED}") from error


def _parsed(text: str, source: str) -> Calibration:
    text = "\n".join(_COMMENT.sub("", line) for line in text.splitlines())
    if colmap := _COLMAP.findall(text):
        return _from_colmap(colmap, source)
    if (matrix := _MATRIX.search(text)) and (numbers := _flat(text[matrix.end() :], source, count=9)):
        return _with_keys(_from_numbers(numbers, source), text, source)
    keys = _keyed(text)
    if keys.keys() & {"fx", "fy", "cx", "cy"}:
        if missing := [name for name in ("fx", "fy", "cx", "cy") if name not in keys]:
            raise RecordingError(f"{source}: {', '.join(missing)} missing, {_EXPECTED}, or lines of fx: 525 and so on")
        camera = Calibration(keys["fx"], keys["fy"], keys["cx"], keys["cy"], source=source)
        return _with_keys(camera, text, source)
    return _from_rows(_rows(text, source), source)


def from_matrix(K: NDArray[np.float64], source: str) -> Calibration:
    """The camera of a matrix (3, 3), by rows or by columns; raises RecordingError if it is not a pinhole's, or its pixels are slanted."""
    if K[0, 2] == K[1, 2] == 0 and K[2, 0] > 0 and K[2, 1] > 0:  # stored by columns, as Open3D and Record3D do
        K = K.T
    zeros = K[[1, 2, 2], [0, 0, 1]]
    if not (np.isfinite(K).all() and np.abs(zeros).max() <= _EXACT and abs(K[2, 2] - 1) <= _EXACT):
        raise RecordingError(f"{source}: not a pinhole matrix, expected rows fx 0 cx, 0 fy cy, 0 0 1")
    if abs(K[0, 1]) > MAX_SKEW * abs(K[0, 0]):
        raise RecordingError(f"{source}: a skew of {K[0, 1]:g} px, expected fx 0 cx in the first row: calibrate the camera without skew")
    fx, fy, cx, cy = (float(value) for value in K[[0, 1, 0, 1], [0, 1, 2, 2]])
    return Calibration(fx, fy, cx, cy, source=source)


def units_per_metre(scale: float | None) -> float | None:
    """A depth scale in units per metre, of one that may be in metres per unit, such as 0.001; None without one."""
    return 1 / scale if scale is not None and 0 < scale < _METRES_PER_UNIT else scale


def checked_distortion(values: Sequence[float], source: str, *, fisheye: bool = False) -> tuple[float, ...] | None:
    """OpenCV's distortion values; None if all are 0. Raises RecordingError for another number of them, and for a fisheye lens."""
    if not any(values):
        return None
    if fisheye:
        raise RecordingError(f"{source}: a fisheye lens, expected k1 k2 p1 p2 [k3 [k4 k5 k6]] of a pinhole: rectify the images first")
    if len(values) not in DISTORTION_LENGTHS:
        raise RecordingError(f"{source}: {len(values)} distortion values, expected k1 k2 p1 p2 [k3 [k4 k5 k6]]")
    return tuple(values)


def _from_colmap(lines: list[tuple[str, str, str, str]], source: str) -> Calibration:
    """COLMAP counts pixel centres from 0.5."""
    if len(set(lines)) > 1:
        raise RecordingError(f"{source}: {len(lines)} cameras, expected one for all images: keep the line of the recording's camera")
    model, width, height, rest = lines[0]
    values = _flat(rest, source)
    if model not in _COLMAP_MODELS:
        raise RecordingError(f"{source}: a camera of model {model}, expected {', '.join(_COLMAP_MODELS)}: undistort the images first")
    pinhole, lens = _COLMAP_MODELS[model]
    if len(values) <= max([*pinhole, *(i for i in lens if i is not None)]):
        raise RecordingError(f"{source}: {len(values)} values of model {model}, expected more: export the model again")
    fx, fy, cx, cy = (values[i] for i in pinhole)
    distortion = checked_distortion([0.0 if i is None else values[i] for i in lens], source)
    return Calibration(fx, fy, cx - 0.5, cy - 0.5, int(width), int(height), distortion, source=source)


def _keyed(text: str) -> dict[str, float]:
    keys: dict[str, float] = {}
    for name, number in _KEYED.findall(text):
        keys.setdefault(_KEYS[name.lower()], float(number.replace(",", ".")))
    if (f := keys.pop("f", None)) is not None:
        keys = {"fx": f, "fy": f} | keys
    return keys


def _with_keys(camera: Calibration, text: str, source: str) -> Calibration:
    """The camera with image size, distortion and depth scale, if the text names them."""
    keys, coefficients = _keyed(text), _COEFFICIENTS.search(text)
    lens = _flat(coefficients[1], source) if coefficients else [keys.get(k, 0.0) for k in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")]
    if not coefficients:
        lens = lens if any(lens[5:]) else lens[:5]
    width, height = (int(keys[name]) or None if name in keys else None for name in ("width", "height"))
    distortion = checked_distortion(lens, source, fisheye=bool(_FISHEYE.search(text)))
    scale = units_per_metre(keys.get("scale")) or None
    return Calibration(camera.fx, camera.fy, camera.cx, camera.cy, width, height, distortion, scale, source=source)


def _rows(text: str, source: str) -> list[list[float]]:
    """The numbers of each line that has some; names of columns, and a name before the numbers, are passed over.

    Raises RecordingError for other words.
    """
    lines = [_LABEL.sub("", line) for line in _BRACKETS.sub(" ", text).splitlines()]
    lines = [line for line in lines if not all(map(_NAME.fullmatch, re.split(r"[\s,;]+", line.strip())))]
    words = [word for line in lines for word in re.split(r"[\s;]+", line) if word]
    decimal_comma = all(map(_DECIMAL_COMMA.fullmatch, words))
    rows = []
    for line in lines:
        try:
            rows.append([float(word) for word in re.split(r"[\s;,]+", line.replace(",", ".") if decimal_comma else line) if word])
        except ValueError as error:
            raise RecordingError(f"{source}: {error}, {_EXPECTED}") from error
    return [row for row in rows if row]


def _flat(text: str, source: str, count: int | None = None) -> list[float]:
    """All numbers of a text, or the first `count` up to where a word begins."""
    if count is not None:
        text = re.match(r"[^A-DF-Za-df-z]*", text)[0]  # type: ignore[index]  # it matches any text
    return [number for row in _rows(text, source) for number in row][:count]


def _from_rows(rows: list[list[float]], source: str) -> Calibration:
    lengths = [len(row) for row in rows]
    if lengths and max(lengths) == 1:  # one number a line
        return _from_numbers([row[0] for row in rows], source)
    if lengths in ([3] * 3, [4] * 3, [4] * 4):
        return from_matrix(np.array(rows)[:3, :3], source)
    if lengths in [[3, 3, 3, n] for n in DISTORTION_LENGTHS]:
        camera = from_matrix(np.array(rows[:3]), source)
        return Calibration(camera.fx, camera.fy, camera.cx, camera.cy, distortion=checked_distortion(rows[3], source), source=source)
    if len(rows) == 1 or lengths in [[4, n] for n in DISTORTION_LENGTHS] or lengths == [2, 4]:
        return _from_numbers([number for row in rows for number in row], source)
    raise _refusal(f"{len(rows)} rows of {sorted(set(lengths))} numbers" if rows else "no numbers", source)


def _from_numbers(n: list[float], source: str) -> Calibration:
    """The camera of numbers in a row: a matrix, or fx fy cx cy after or before the image size, with distortion."""
    if len(n) in (9, 12, 16):
        K = np.array(n).reshape(3 if len(n) == 9 else -1, 3 if len(n) == 9 else 4)[:3, :3]
        if (K[2, 2] == 1 and K[1, 0] == 0 and (K[2, :2] == 0).all()) or (len(n) == 9 and K[2, 2] == 1 and (K[:2, 2] == 0).all()):
            return from_matrix(K, source)
    width, height = None, None
    if len(n) in (6, 10, 11, 14) and _is_size(n[:2], n[4:6]):
        (width, height), n = (int(n[0]), int(n[1])), n[2:]
    elif len(n) == 6 and _is_size(n[4:6], n[2:4]):
        (width, height), n = (int(n[4]), int(n[5])), n[:4]
    if len(n) not in (4, *(4 + k for k in DISTORTION_LENGTHS)):
        raise _refusal(f"{len(n)} number{'s' * (len(n) != 1)}", source)
    fx, fy, cx, cy, *distortion = n
    return Calibration(fx, fy, cx, cy, width, height, checked_distortion(distortion, source), source=source)


def _is_size(size: list[float], centre: list[float]) -> bool:
    """Whether two numbers are an image size [px] with the principal point `centre` inside; distortion values are far below 2."""
    return all(s == int(s) and 2 < c < s for s, c in zip(size, centre) if np.isfinite(s)) and bool(np.isfinite(size).all())


def _refusal(found: str, source: str) -> RecordingError:
    return RecordingError(f"{source}: {found}, {_EXPECTED}")
