"""transform.json: the axes of the exports in a folder.

`up` is the axis that points up in the newest export (z, y or camera); `T_export_world` (4 x 4, by rows) maps the run's world, which is
the first camera (x right, y down, z forward), into its axes; `exports` has both of each format.
"""

import json
from typing import Any

from idfslam.export.axes import Axes
from idfslam.storage import atomic_files
from idfslam.storage.ledger import Ledger

RECORD = "transform.json"


def note_axes(ledger: Ledger, name: str, axes: Axes, *, newest: Axes) -> None:
    """Writes the axes of a format into the folder's transform.json, beside those of earlier exports."""
    path = ledger.folder / RECORD
    known = json.loads(path.read_text(encoding="utf-8"))["exports"] if ledger.owns(RECORD) else {}
    atomic_files.write_json(path, {**_values(newest), "exports": known | {name: _values(axes)}})
    ledger.record([RECORD])


def _values(axes: Axes) -> dict[str, Any]:
    return {"up": axes.up, "T_export_world": axes.T_ew}
