"""The result of an evaluation: the errors of one run, as a record and as JSON."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from idfslam.evaluation.doubt import DoubtRates
from idfslam.evaluation.mesh_error import MeshError
from idfslam.evaluation.trajectory_error import AbsoluteTrajectoryError, RelativePoseError
from idfslam.storage import atomic_files

SCHEMA = 1  # of evaluation.json; counts up when a reader of the older form would misread the file


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """The errors of the poses of some frames."""

    frames: int  # with and without ground truth
    ate: AbsoluteTrajectoryError
    rpe: tuple[RelativePoseError, ...]  # one for each distance in frames for which there are pairs of frames

    def to_dict(self) -> dict[str, Any]:
        """All errors under keys that name their units (metres, degrees), as values that JSON has."""
        values: dict[str, Any] = {"frames": self.frames, "frames_with_truth": len(self.ate.frames)}
        values |= {"ate_m": asdict(self.ate.translation), "T_gt_est": self.ate.T_gt_est.tolist()}
        for rpe in self.rpe:
            pairs = {"pairs": len(rpe.frames)}
            values[f"rpe_{rpe.delta}"] = {**pairs, "translation_m": asdict(rpe.translation), "rotation_deg": asdict(rpe.rotation)}
            if rpe.delta == 1:
                values["jump"] = asdict(rpe.largest_jump)
        return values


@dataclass(frozen=True, eq=False)
class Evaluation(PoseErrors):
    """The errors of one run."""

    mesh: MeshError | None  # None: no true mesh was given, or nothing of the mesh counts under the protocol
    measured: PoseErrors | None = None  # of the frames whose pose was measured; None: unknown, or none of them has ground truth
    doubt: DoubtRates | None = None  # how well the statuses told which poses were wrong; None: unknown

    def to_dict(self) -> dict[str, Any]:
        """All errors under keys that name their units (metres, degrees), as values that JSON has."""
        values = super().to_dict()
        if self.measured is not None:
            values["measured"] = self.measured.to_dict()
        if self.doubt is not None:
            values["doubt"] = self.doubt.to_dict()
        if self.mesh is not None:
            values["mesh"] = asdict(self.mesh)
        return values

    def save(self, path: Path) -> None:
        """Writes `to_dict` as JSON, with the version of its form; a number that is not finite becomes null."""
        atomic_files.write_json(path, {"schema": SCHEMA} | self.to_dict())
