"""Errors of a reconstructed surface: accuracy, completion, completion ratio and depth L1, under a named protocol (`protocols.py`)."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.errors import ResultError
from idfslam.evaluation.culling import faces_kept, in_any_view, subdivided, submesh, virtual_views
from idfslam.evaluation.depth_error import depth_error
from idfslam.evaluation.depth_range import DepthRange
from idfslam.evaluation.icp import icp
from idfslam.evaluation.protocols import Protocol, find_protocol
from idfslam.evaluation.surface_samples import SurfaceSamples, median_angle, to_points, to_surface
from idfslam.geometry.camera import Camera
from idfslam.geometry.ray_casting import RayCaster

Floats = NDArray[np.float64]
SAMPLES = 200_000  # points on each surface, as in the published protocols; raised, the errors scatter less and take longer
VIEWS = 1000  # for depth L1, as in NICE-SLAM; raised, depth L1 scatters less and takes longer
_FOUND = 0.05  # [m] distance up to which the reconstruction contains a true point, 5 cm as published; raised, the completion ratio is
#    larger
_CLOSE = 0.01  # [m] distance up to which a point counts as right in precision, recall and F1; raised, all three are larger
_ICP_REACH = 0.1  # [m] largest distance of points that ICP pairs; raised, ICP corrects larger misalignments. NICE-SLAM's value
_VIRTUAL_REACH = 1.0  # [m] of virtual views from recorded camera centres; raised, more hidden surface counts. Chosen by hand
_VIRTUAL_CAMERA = Camera(480, 480, 240.0, 240.0, 239.5, 239.5)  # 90 degrees wide: six of them see all directions


@dataclass(frozen=True)
class MeshError:
    """Errors of a reconstruction under a protocol."""

    protocol: str
    near: float  # [m] the depth range in which surface counts as in view
    far: float  # [m]
    range_from: str  # the source of near and far: "recording" (its readings) or "protocol"
    accuracy: float  # [m] mean distance from points of the reconstruction to the true points
    completion: float  # [m] mean distance from the true points to points of the reconstruction
    completion_ratio: float  # share of true points with reconstruction within 5 cm
    precision: float  # share of points of the reconstruction with true surface within 1 cm
    recall: float  # share of true points with reconstruction within 1 cm
    f1: float  # harmonic mean of precision and recall
    normal_angle: float  # [deg] median angle between the planes of the reconstruction and of the nearest true triangles
    depth_l1: float | None  # [m]; None: no view was requested, or none shows true surface
    depth_missing: float | None  # share of pixels that show true surface but no reconstruction
    samples: int  # points on each surface
    views: int  # views that depth L1 was measured in
    icp_shift: float  # [m] by which ICP moved the reconstruction's centre; 0 without ICP


def mesh_error(
    reconstruction: trimesh.Trimesh,
    truth: trimesh.Trimesh,
    *,
    poses: Floats,
    camera: Camera,
    protocol: str = "seen",
    T_gt_est: Floats | None = None,
    sensor_range: DepthRange | None = None,
    samples: int = SAMPLES,
    views: int = VIEWS,
    seed: int = 0,
) -> MeshError:
    """Errors of a reconstruction [m] against the true mesh [m], both seen from the true poses of the recorded frames.

    poses: (N, 4, 4) camera-to-world in the frame of the truth; those with NaN are left out. T_gt_est: (4, 4), moves the reconstruction into
    the frame of the truth. sensor_range: the depths that the sensor read; used by protocols with `sensor_limited`.

    Raises `ConfigError` for an unknown protocol, `ResultError` if a mesh is empty or the protocol leaves nothing of it.
    """
    rules = find_protocol(protocol)
    if not rules.sensor_limited:
        sensor_range = None
    if sensor_range is not None:
        rules = rules.limited_to(sensor_range)
    known = poses[np.isfinite(poses).all((1, 2))]
    if len(known) == 0:
        raise ResultError("no frame has a true pose; the mesh's error needs the true poses of the recorded frames to know what was seen")
    _check_mesh(reconstruction, "reconstruction")
    _check_mesh(truth, "true mesh")
    moved = reconstruction.copy().apply_transform(np.eye(4) if T_gt_est is None else T_gt_est)
    truth_caster, fine_truth, fine = RayCaster(truth), subdivided(truth), subdivided(moved)
    kept_truth = _cull(fine_truth, truth_caster, truth_caster, known, camera, rules, seed, "true mesh")
    kept = submesh(fine, _cull(fine, RayCaster(moved), truth_caster, known, camera, rules, seed, "reconstruction"))
    points = SurfaceSamples.of(kept, samples, seed + 1)
    true_points = SurfaceSamples.of(submesh(fine_truth, kept_truth), samples, seed)
    T = icp(points.points, true_points.points, threshold=_ICP_REACH) if rules.icp else np.eye(4)
    points, kept = points.moved(T), kept.apply_transform(T)
    if rules.point_to_surface:
        seen = in_any_view(true_points.points, known[:: rules.stride], camera, rules.rule, occluder=truth_caster)
        # Reconstructed surface that is true is no error, even if it was never seen: hence all of the truth
        accuracy, nearest = to_surface(points.points, SurfaceSamples.of(fine_truth, samples, seed), fine_truth)
        completion, _ = to_surface(true_points.points[seen], points, kept)
    else:
        accuracy, nearest = to_points(points.points, true_points)
        completion, _ = to_points(true_points.points, points)
    depth = depth_error(RayCaster(kept), RayCaster(fine_truth), kept_truth, known, views=views, seed=seed)
    return MeshError(
        protocol=rules.name,
        near=rules.rule.near,
        far=rules.rule.far,
        range_from="protocol" if sensor_range is None else "recording",
        **_distance_errors(accuracy, completion),
        normal_angle=median_angle(points.triangles, nearest),
        depth_l1=None if depth is None else depth.l1_with_missing if rules.missing_is_zero else depth.l1,
        depth_missing=None if depth is None else depth.missing,
        samples=samples,
        views=0 if depth is None else depth.views,
        icp_shift=float(np.linalg.norm(T[:3, 3] + (T[:3, :3] - np.eye(3)) @ points.points.mean(0))),
    )


def _distance_errors(accuracy: Floats, completion: Floats) -> dict[str, float]:
    """The errors that follow from distances [m]: of the reconstruction's points (N,), and of the true points (M,)."""
    precision, recall = float((accuracy < _CLOSE).mean()), float((completion < _CLOSE).mean())
    return {
        "accuracy": float(accuracy.mean()),
        "completion": float(completion.mean()),
        "completion_ratio": float((completion < _FOUND).mean()),
        "precision": precision,
        "recall": recall,
        "f1": 2 * precision * recall / max(precision + recall, 1e-12),
    }


def _check_mesh(mesh: trimesh.Trimesh, name: str) -> None:
    if len(mesh.faces) == 0 or not np.isfinite(mesh.vertices).all() or mesh.area == 0:
        raise ResultError(
            f"the {name} has {len(mesh.vertices)} vertices and {len(mesh.faces)} faces; expected a surface, finite, in metres"
        )


def _cull(
    mesh: trimesh.Trimesh, own: RayCaster, truth: RayCaster, poses: Floats, camera: Camera, protocol: Protocol, seed: int, name: str
) -> NDArray[np.bool_]:
    """(F,) the faces that count under the protocol."""
    occluder = {"itself": own, "truth": truth}[protocol.occluder] if protocol.occlusion else None
    chosen = poses[:: protocol.stride]
    kept = faces_kept(mesh, in_any_view(mesh.vertices, chosen, camera, protocol.rule, occluder=occluder))
    if protocol.virtual_positions:
        in_frustum = faces_kept(mesh, in_any_view(mesh.vertices, chosen, camera, protocol.rule))
        views = virtual_views(truth, chosen, positions=protocol.virtual_positions, reach=_VIRTUAL_REACH, seed=seed)
        kept |= in_frustum & faces_kept(mesh, in_any_view(mesh.vertices, views, _VIRTUAL_CAMERA, protocol.rule, occluder=occluder))
    if not kept.any():
        raise ResultError(
            f"nothing of the {name} is visible in the {len(chosen)} true poses under the protocol '{protocol.name}'; "
            "expected mesh and poses in one frame, metres, camera-to-world with z forward"
        )
    return kept
