"""Points with properties as binary PLY (little endian)."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from idfslam import __version__

_NAMES = {"<f4": "float", "u1": "uchar"}  # of numpy's types in PLY


def binary_ply(properties: Mapping[str, tuple[str, ArrayLike]]) -> bytes:
    """The file of N points. properties: name -> numpy's type (`<f4` or `u1`) and the values (N,), in their order."""
    count = len(np.asarray(next(iter(properties.values()))[1]))
    rows = np.zeros(count, [(name, kind) for name, (kind, _) in properties.items()])
    for name, (_, values) in properties.items():
        rows[name] = values
    lines = "".join(f"property {_NAMES[kind]} {name}\n" for name, (kind, _) in properties.items())
    header = f"ply\nformat binary_little_endian 1.0\ncomment idf-slam {__version__}\nelement vertex {count}\n{lines}end_header\n"
    return header.encode() + rows.tobytes()
