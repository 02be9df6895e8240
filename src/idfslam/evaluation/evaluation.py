"""The result of an evaluation: the errors of one run, as a record and as JSON."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from idfslam.evaluation.mesh_error import MeshError
from idfslam.evaluation.trajectory_error import AbsoluteTrajectoryError, RelativePoseError
from idfslam.storage import atomic_files


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The errors of one run."""

    frames: int  # of the trajectory, with and without ground truth
    ate: AbsoluteTrajectoryError
    rpe: tuple[RelativePoseError, ...]  # one for each distance in frames for which there are pairs of frames
    mesh: MeshError | None  # None: no true mesh was given, or nothing of the mesh counts under the protocol

    def to_dict(self) -> dict[str, Any]:
        """All errors under keys that name their units (metres, degrees), as values that JSON has."""
        values: dict[str, Any] = {"frames": self.frames, "frames_with_truth": len(self.ate.frames)}
        values |= {"ate_m": asdict(self.ate.translation), "T_gt_est": self.ate.T_gt_est.tolist()}
        for rpe in self.rpe:
            pairs = {"pairs": len(rpe.frames)}
            values[f"rpe_{rpe.delta}"] = {**pairs, "translation_m": asdict(rpe.translation), "rotation_deg": asdict(rpe.rotation)}
        if self.mesh is not None:
            values["mesh"] = asdict(self.mesh)
        return values

    def save(self, path: Path) -> None:
        """Writes `to_dict` as JSON; a number that is not finite becomes null."""
        atomic_files.write_json(path, self.to_dict())
