"""The axes of exported files: z up, y up, or the run's own world, which is the first camera (x right, y down, z forward).

The origin is the first camera, whatever the axes are. z up and y up are the level coordinates of the report (`geometry/level.py`).
"""

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idfslam.export.formats import Up
from idfslam.export.run_surface import mesh_of_run
from idfslam.geometry.level import LevelFrame, level
from idfslam.runs.finished_run import FinishedRun

log = logging.getLogger(__name__)

_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # turns z up into y up; importers of glTF turn it back
_HALF_TURN = np.diag([1.0, -1.0, -1.0, 1.0])  # about x: y points up instead of down


@dataclass(frozen=True, eq=False)
class Axes:
    """The axes of one export."""

    up: Up
    T_ew: NDArray[np.float64]  # (4, 4) the run's world into these axes
    by_gravity: bool  # False: no floor, table or ceiling was found, and up is the first camera's

    @staticmethod
    def of(run: FinishedRun, up: Up) -> "Axes":
        """Found from the mesh and the trajectory of the run."""
        if up == "camera":
            return Axes(up, np.eye(4), True)
        upright = Axes.upright(level(mesh_of_run(run), run.trajectory.poses))
        return upright if up == "z" else Axes(up, _Y_UP @ upright.T_ew, upright.by_gravity)

    @staticmethod
    def upright(found: LevelFrame) -> "Axes":
        """Those of level coordinates: z up."""
        T_lw = np.eye(4)
        T_lw[:3, :3] = found.R_lw
        return Axes("z", T_lw, found.by_gravity)

    @property
    def gltf(self) -> "Axes":
        """The axes of a GLB file of the same export: in glTF y always points up."""
        turn = {"z": _Y_UP, "y": np.eye(4), "camera": _HALF_TURN}[self.up]
        return Axes("y", turn @ self.T_ew, self.by_gravity)

    def warn_if_not_level(self) -> None:
        """Warns if what is up is not known by gravity."""
        if not self.by_gravity:
            log.warning("no floor was found: up is the up of the first camera")
