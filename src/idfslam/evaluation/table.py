"""The errors of an evaluation as a table for the console."""

from rich.markup import escape
from rich.table import Table

from idfslam.evaluation.doubt import OFF_SHIFT, OFF_TURN
from idfslam.evaluation.evaluation import Evaluation, PoseErrors
from idfslam.evaluation.mesh_error import MeshError


def table(evaluation: Evaluation) -> Table:
    """A table in centimetres, degrees and per cent."""
    result = Table(title=f"{evaluation.frames} frames", title_justify="left")
    for column in ("error", "RMSE", "mean", "median", "max", "std"):
        result.add_column(column, justify="left" if column == "error" else "right")
    _add_poses(result, evaluation, "frames")
    if evaluation.measured is not None and evaluation.measured.frames < evaluation.frames:
        result.add_section()
        _add_poses(result, evaluation.measured, "frames with a measured pose")
    rows = _jump_and_doubt(evaluation)
    if rows:
        result.add_section()
        for name, text in rows:
            result.add_row(escape(name), text)
    if evaluation.mesh is not None:
        result.add_section()
        for name, text in _mesh_rows(evaluation.mesh):
            result.add_row(escape(f"{name}, protocol {evaluation.mesh.protocol}"), "", text)
    return result


def _add_poses(result: Table, errors: PoseErrors, kind: str) -> None:
    """The rows of ATE and RPE; `kind` says of which frames."""
    rows = [(f"ATE [cm], {len(errors.ate.frames)} {kind}", errors.ate.translation, 100.0)]
    for rpe in errors.rpe:
        frames = "1 frame" if rpe.delta == 1 else f"{rpe.delta} frames"
        rows += [(f"RPE over {frames} [cm]", rpe.translation, 100.0), (f"RPE over {frames} [deg]", rpe.rotation, 1.0)]
    for name, s, unit in rows:
        result.add_row(escape(name), *(f"{value * unit:.3f}" for value in (s.rmse, s.mean, s.median, s.max, s.std)))


def _jump_and_doubt(evaluation: Evaluation) -> list[tuple[str, str]]:
    """The largest jump, and how well the statuses told which poses were wrong."""
    rows = []
    for jump in (rpe.largest_jump for rpe in evaluation.rpe if rpe.delta == 1):
        rows.append(("largest jump to the next frame [cm]", f"{jump.translation_m * 100:.2f}, at frame {jump.translation_frame}"))
        rows.append(("largest jump to the next frame [deg]", f"{jump.rotation_deg:.2f}, at frame {jump.rotation_frame}"))
    if evaluation.doubt is not None:
        d = evaluation.doubt
        limits = f"{OFF_SHIFT * 100:.0f} cm or {OFF_TURN:.0f} degrees"
        rows.append((f"frames off by more than {limits}, called good [%]", _share(d.missed, d.off)))
        rows.append(("good frames called doubtful or lost [%]", _share(d.false_alarms, d.good)))
    return rows


def _share(found: int, of: int) -> str:
    return f"{100 * found / of:.1f} ({found} of {of})" if of else "none"


def _mesh_rows(mesh: MeshError) -> list[tuple[str, str]]:
    rows = [
        ("accuracy [cm]", f"{mesh.accuracy * 100:.2f}"),
        ("completion [cm]", f"{mesh.completion * 100:.2f}"),
        ("completion ratio < 5 cm [%]", f"{mesh.completion_ratio * 100:.1f}"),
        ("precision, F1 at 1 cm [%]", f"{mesh.precision * 100:.1f}, {mesh.f1 * 100:.1f}"),
        ("normals off, median [deg]", f"{mesh.normal_angle:.1f}"),
    ]
    if mesh.depth_l1 is not None and mesh.depth_missing is not None:
        rows += [("depth L1 [cm]", f"{mesh.depth_l1 * 100:.2f}"), ("depth missing [%]", f"{mesh.depth_missing * 100:.1f}")]
    rows.append(("depth read [m]" if mesh.range_from == "recording" else "depth [m]", f"{mesh.near:.2f} to {mesh.far:.2f}"))
    return rows
