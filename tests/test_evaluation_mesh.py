"""Mesh errors on boxes whose numbers can be worked by hand; what each protocol counts; pictures; whole result folders."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from idfslam.cli.commands.eval import Eval
from idfslam.config import FAST
from idfslam.errors import ConfigError, FrameError, IdfSlamError, ResultError
from idfslam.evaluation.culling import Visibility, free_positions, in_any_view, subdivided, virtual_views
from idfslam.evaluation.depth_range import DepthRange, depth_range
from idfslam.evaluation.evaluate import evaluate, load_mesh
from idfslam.evaluation.icp import icp
from idfslam.evaluation.mesh_error import MeshError, mesh_error
from idfslam.evaluation.point_triangle import nearest_triangle
from idfslam.evaluation.protocols import PROTOCOLS
from idfslam.evaluation.table import table
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.geometry.level import up_direction
from idfslam.geometry.ray_casting import RayCaster, pixel_rays
from idfslam.geometry.trajectory import Trajectory, save_tum
from idfslam.pictures.direction import best_direction
from idfslam.pictures.mesh_renderer import Picture, looking_at, pose_outside
from idfslam.runs.evaluate_run import evaluate_folder
from idfslam.runs.keyframes_file import KeyframeRecord, write_keyframes
from idfslam.runs.run_config import RecordingSource, write_config

CAMERA = Camera(64, 48, 40.0, 40.0, 31.5, 23.5)
FEW = {"samples": 20_000, "views": 20}
DOWN = np.array([0.0, 0.0, -1.0])


def room(size: tuple[float, float, float] = (4.0, 3.0, 2.5)) -> trimesh.Trimesh:
    return trimesh.creation.box(size)


def turning(count: int = 48) -> NDArray[np.float64]:
    """Cameras that circle the middle of the room and look outwards, tilted down and up in turns: all surface is seen."""
    poses = []
    for i, angle in enumerate(np.linspace(0, 4 * np.pi, count, endpoint=False)):
        out, tilt = np.array([np.cos(angle), np.sin(angle), 0.0]), 0.35 * DOWN * (-1) ** (i // (count // 2))
        poses.append(looking_at(out + tilt, 0.3 * out, -DOWN))
    poses += [looking_at(DOWN * s, np.array([0.1, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])) for s in (1, -1)]
    return np.array(poses)


def error(reconstruction: trimesh.Trimesh, **options: object) -> MeshError:
    return mesh_error(reconstruction, room(), poses=turning(), camera=CAMERA, **{**FEW, **options})  # type: ignore[arg-type]


def test_a_perfect_reconstruction_has_no_error() -> None:
    e = error(room())
    assert e.protocol == "seen"
    assert e.accuracy < 1e-6 and e.completion < 1e-6 and e.completion_ratio == 1
    assert e.precision == e.recall == e.f1 == 1 and e.normal_angle < 1e-3
    assert e.depth_l1 is not None and e.depth_l1 < 1e-5 and e.depth_missing == 0


def test_a_larger_room_by_hand() -> None:
    # Every wall 2 cm further out: accuracy 2 cm but for the edges (at most sqrt(2) there), completion 2 cm likewise
    e = error(room((4.04, 3.04, 2.54)))
    assert e.accuracy == pytest.approx(0.02, rel=0.02) and e.completion == pytest.approx(0.02, rel=0.02)
    assert e.completion_ratio == 1
    # Along a ray depth grows by at least 2 cm / cos(angle to the wall), in z-depth by 2 cm where the camera faces the wall
    assert e.depth_l1 is not None and 0.02 < e.depth_l1 < 0.06


def test_precision_recall_and_normals_by_hand() -> None:
    # Walls 0.9 and 1.1 cm further out: all points are within 1 cm, or none but for edges
    near, far = error(room((4.018, 3.018, 2.518))), error(room((4.022, 3.022, 2.522)))
    assert near.precision > 0.97 and near.recall > 0.97 and near.f1 > 0.97
    assert far.precision < 0.01 and far.recall < 0.01
    turned = error(room().apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(0.5), [0, 0, 1])))
    # A turn about z leaves the normals of floor and ceiling, 24 of 59 m^2, as they are, and turns those of the walls
    assert turned.normal_angle == pytest.approx(0.5, abs=0.01)


def test_a_missing_floor_by_hand() -> None:
    # The floor is 12 of the room's 2 * (12 + 10 + 7.5) = 59 m^2. Its points within 5 cm of a wall still count: a rim of
    # 12 - 3.9 * 2.9 = 0.69 m^2. So the ratio is 1 - 11.31 / 59 = 0.808; accuracy stays 0
    box = room()
    open_box = trimesh.Trimesh(box.vertices, box.faces[box.face_normals[:, 2] > -0.5], process=False)
    e = error(open_box, samples=40_000)
    assert e.accuracy < 1e-4 and e.precision == 1 and e.recall < 0.82 and e.f1 == pytest.approx(2 * e.recall / (1 + e.recall))
    assert e.completion_ratio == pytest.approx(1 - 11.31 / 59, abs=0.01)
    assert e.depth_missing is not None and 0.03 < e.depth_missing < 0.5
    nice = error(open_box, protocol="neural-rgbd")
    assert nice.depth_l1 is not None and nice.depth_l1 > 0.05  # missing surface counts with depth 0 there


def test_the_reconstruction_is_moved_by_the_alignment() -> None:
    T = looking_at(np.array([1.0, 0.2, 0.3]), np.array([0.5, 2.0, 0.0]), -DOWN)
    assert error(room().apply_transform(np.linalg.inv(T)), T_gt_est=T).accuracy < 1e-6


def test_same_seed_same_numbers() -> None:
    rough = trimesh.permutate.noise(subdivided(room(), max_edge=0.3), 0.01)
    assert error(rough) == error(rough)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_every_protocol_on_a_perfect_reconstruction(protocol: str) -> None:
    # Between two sets of n points on an area A the mean nearest distance is sqrt(A / n) / 2 = 2.7 cm here, but 0 for ours
    e = error(room(), protocol=protocol)
    assert e.protocol == protocol
    assert e.accuracy == pytest.approx(0 if protocol == "seen" else 0.5 * (59 / 20_000) ** 0.5, abs=2e-3)
    assert e.depth_l1 == pytest.approx(0, abs=2e-3)


def test_icp_of_nice_takes_out_a_shift() -> None:
    shifted = room().apply_translation([0.03, -0.02, 0.01])
    e = error(shifted, protocol="nice")
    assert e.icp_shift == pytest.approx((9 + 4 + 1) ** 0.5 / 100, abs=0.004)
    assert e.accuracy < error(shifted, protocol="neural-rgbd").accuracy + 1e-3


def test_icp_recovers_a_small_motion_and_leaves_far_points() -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (2000, 3))
    T = trimesh.transformations.rotation_matrix(0.01, [1, 2, 3])
    T[:3, 3] = [0.01, 0.0, -0.01]
    assert np.abs(icp(points, points @ T[:3, :3].T + T[:3, 3], threshold=0.1) - T).max() < 1e-6
    assert np.array_equal(icp(points, points + 100, threshold=0.1), np.eye(4))


def half_recording() -> NDArray[np.float64]:
    """Cameras that see the wall at x = +2 alone."""
    return np.array([looking_at(np.array([1.0, y, 0.0]), np.array([0.5, y, 0.0]), -DOWN) for y in (-0.2, 0.0, 0.2)])


def test_only_what_was_seen_counts_as_truth() -> None:
    wall = trimesh.Trimesh(room().vertices, room().faces[room().face_normals[:, 0] > 0.5], process=False)
    seen = mesh_error(subdivided(wall), room(), poses=half_recording(), camera=CAMERA, **FEW)  # type: ignore[arg-type]
    # 1.5 m from the wall the image spans 64 / 40 * 1.5 = 2.4 m, + 0.4 m of motion, x 48 / 40 * 1.5 = 1.8 m: nothing but the wall
    assert seen.completion_ratio == 1 and seen.accuracy < 1e-4 and seen.depth_missing == 0


def squares(*, far: float = 3.0) -> trimesh.Trimesh:
    """Two of 0.5 m x 0.5 m that a camera in the origin sees side by side, 1 m and `far` [m] ahead."""
    square = np.array([[0.0, -0.25, 0.0], [0.5, -0.25, 0.0], [0.5, 0.25, 0.0], [0.0, 0.25, 0.0]])
    vertices = np.concatenate([square + np.array([-0.6, 0, 1]), square + np.array([0.3, 0, far])])
    return trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], process=False)


def test_what_the_sensor_does_not_reach_is_not_seen() -> None:
    def of(reconstruction: trimesh.Trimesh, protocol: str = "seen", sensor_range: DepthRange | None = None) -> MeshError:
        options = {**FEW, "protocol": protocol, "sensor_range": sensor_range}
        return mesh_error(reconstruction, squares(), poses=np.eye(4)[None], camera=CAMERA, **options)  # type: ignore[arg-type]

    near = trimesh.Trimesh(squares().vertices, squares().faces[:2], process=False)
    reach = DepthRange(0.5, 2.0)
    # Half of the true surface in view is missing (a little less: at its rim are pixels whose middle shows nothing), but a sensor that
    # reads 0.5 to 2 m does not read that half
    assert of(near).completion_ratio == pytest.approx(0.5, abs=0.03)
    narrowed = of(near, sensor_range=reach)
    assert narrowed.completion_ratio == 1 and (narrowed.near, narrowed.far, narrowed.range_from) == (0.5, 2.0, "recording")
    # The same rule for the reconstruction: half of it 0.2 m too far, but beyond the reach
    assert of(squares(far=3.2)).accuracy == pytest.approx(0.1, abs=0.005)
    assert of(squares(far=3.2), sensor_range=reach).accuracy < 1e-4
    # Wider readings widen nothing, and the published protocols keep their range
    wide = of(near, sensor_range=DepthRange(0.02, 30.0))
    assert (wide.near, wide.far) == (0.1, 10) and wide.completion_ratio == of(near).completion_ratio
    published = of(near, "neural-rgbd", reach)
    assert (published.near, published.far, published.range_from) == (0.01, 10, "protocol")


@dataclass
class DepthImages:
    """A recording of `turning` in `room` with depth images of our own; an error stands for a frame that cannot be read."""

    depths: Sequence[NDArray[np.float32] | FrameError]
    name: str = "depths"
    camera: Camera = CAMERA

    @property
    def timestamps(self) -> NDArray[np.float64]:
        return np.arange(len(self)) / 10

    @property
    def ground_truth(self) -> NDArray[np.float64]:
        return turning()[: len(self)]

    def __len__(self) -> int:
        return len(self.depths)

    def __getitem__(self, i: int) -> Frame:
        depth = self.depths[i]
        if isinstance(depth, FrameError):
            raise depth
        camera = self.camera.resized(depth.shape[1], depth.shape[0])
        return Frame(i, i / 10, np.zeros((*depth.shape, 3), np.float32), depth, camera)

    def surface(self) -> trimesh.Trimesh:
        return room()


def test_depth_range_by_hand() -> None:
    # 10 000 readings: 0.4 to 4.4 m, but for 9 of 9 m and 9 of 0.1 m, fewer than a thousandth; pixels without reading do not count
    image = np.zeros((100, 200), np.float32)
    image[:50] = np.linspace(0.4, 4.4, 10_000, dtype=np.float32).reshape(50, 200)
    image[0, :9], image[1, :9] = 9.0, 0.1
    found = depth_range(DepthImages([image]))
    assert found is not None
    assert found.near == pytest.approx(0.4, abs=0.01) and found.far == pytest.approx(4.4, abs=0.01)
    image[0, :11] = 9.0  # more than a thousandth
    more = depth_range(DepthImages([image]))
    assert more is not None and more.far == 9.0
    nothing, damaged = np.zeros((4, 4), np.float32), FrameError("damaged")
    assert depth_range(DepthImages([damaged, nothing, np.full((4, 4), 2.0, np.float32)])) == DepthRange(2.0, 2.0)
    assert depth_range(DepthImages([nothing, damaged])) is None


def test_frustum_and_occlusion_by_hand() -> None:
    # A plate 1 m ahead hides the middle of a wall 2 m ahead; its shadow is twice its size
    wall, plate = trimesh.creation.box((4, 4, 0.01)).apply_translation([0, 0, 2.005]), trimesh.creation.box((0.5, 0.5, 0.01))
    scene = trimesh.util.concatenate([wall, plate.apply_translation([0, 0, 1.0])])
    points = np.array([[0.45, 0, 2.0], [0.6, 0, 2.0], [0, 0, 0.995], [0, 0, -2.0], [1.7, 0, 2.0], [0.6, 0, 2.02], [0.6, 0, 2.05]])
    rule = Visibility(0.1, 10.0, 0.03)
    pose = np.eye(4)[None]
    assert in_any_view(points, pose, CAMERA, rule).tolist() == [True, True, True, False, False, True, True]
    hidden = in_any_view(points, pose, CAMERA, rule, occluder=RayCaster(scene))
    assert hidden.tolist() == [False, True, True, False, False, True, False]
    assert not in_any_view(points, pose, CAMERA, Visibility(0.1, 1.5, 0.03))[1]


def test_virtual_views_stand_in_free_space_and_see_all_of_a_room() -> None:
    caster = RayCaster(room())
    views = virtual_views(caster, turning(), positions=4, reach=5.0, seed=0)
    assert views.shape == (24, 4, 4) and np.allclose(np.linalg.det(views[:, :3, :3]), 1)
    free = free_positions(caster, turning(), count=200, reach=5.0, seed=1)
    assert (np.abs(free) < [2, 1.5, 1.25]).all()
    cube = Camera(100, 100, 50.0, 50.0, 49.5, 49.5)
    assert in_any_view(subdivided(room()).vertices, views[:6], cube, Visibility(0.0, 10.0, 0.1), occluder=caster).mean() > 0.99


def test_subdivision_keeps_the_surface() -> None:
    fine = subdivided(room(), max_edge=0.2)
    assert fine.area == pytest.approx(room().area) and fine.edges_unique_length.max() <= 0.2


def test_user_mistakes() -> None:
    with pytest.raises(ConfigError, match="unknown protocol 'nicer'; expected one of seen, nice"):
        error(room(), protocol="nicer")
    with pytest.raises(ResultError, match="the reconstruction has 0 vertices"):
        error(trimesh.Trimesh())
    with pytest.raises(ResultError, match="nothing of the reconstruction is visible"):
        error(room((0.1, 0.1, 0.1)).apply_translation([500, 0, 0]))
    with pytest.raises(ResultError, match="no frame has a true pose"):
        mesh_error(room(), room(), poses=np.full((3, 4, 4), np.nan), camera=CAMERA)


def test_rendered_depth_and_colour_by_hand() -> None:
    mesh = room()
    mesh.visual.vertex_colors = np.tile(np.array([200, 100, 50, 255], np.uint8), (8, 1))
    T_wc = looking_at(np.array([1.0, 0.0, 0.0]), np.zeros(3), -DOWN)
    picture = Picture(mesh)
    rgb, depth = picture.draw(T_wc, CAMERA), picture.depth(T_wc, CAMERA)
    # Wall at 2 m: z-depth 2 over the whole image but the last rows (1.25 m / 2 m * 40 = 25 px > 24: all rows) and columns (30 px of 32)
    assert depth[:, 2:-2] == pytest.approx(2.0, abs=1e-5)
    assert (rgb == [200, 100, 50]).all()
    cast = RayCaster(mesh).cast(T_wc[:3, 3].astype(np.float32), pixel_rays(CAMERA, T_wc)).distance
    assert cast.reshape(depth.shape) == pytest.approx(depth)
    T_away = looking_at(np.array([100.0, 0, 0]), np.array([50.0, 0, 0]), -DOWN)
    empty_rgb, empty_depth = picture.draw(T_away, CAMERA), picture.depth(T_away, CAMERA)
    assert (empty_depth == 0).all() and (empty_rgb == 0).all()


def test_overview_looks_through_the_near_walls() -> None:
    mesh, poses, camera = room(), turning(), Camera(80, 60, 80.0, 80.0, 39.5, 29.5)
    up = up_direction(mesh, poses)
    assert np.abs(up @ DOWN) > 0.999
    T_wc = pose_outside(mesh, up, best_direction(mesh, poses[:, :3, 3], up), camera)
    depth = Picture(mesh, inside=poses[:, :3, 3]).depth(T_wc, camera)
    outside = Picture(mesh).depth(T_wc, camera)
    assert depth[30, 40] > outside[30, 40] + 1
    assert outside[0].max() == outside[-1].max() == outside[:, 0].max() == outside[:, -1].max() == 0  # all of it fits
    assert (outside > 0).mean() > 0.2


def perfect_result(folder: Path, T: NDArray[np.float64]) -> Path:
    """A perfect result in a frame of its own: T maps the truth into it."""
    save_tum(folder / "trajectory.txt", Trajectory(np.arange(50) / 10, T @ turning()))
    room().apply_transform(T).export(folder / "mesh.ply")
    return folder


@pytest.mark.slow
def test_a_whole_result_folder(tmp_path: Path) -> None:
    T = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3], [1.0, 2.0, 0.5])
    truth = Trajectory(np.arange(50) / 10 + 0.001, turning())
    evaluation = evaluate(perfect_result(tmp_path, T), gt_trajectory=truth, gt_mesh=room(), camera=CAMERA, keyframes=np.array([0, 5]))
    assert evaluation.ate.translation.max < 1e-6 and evaluation.mesh is not None and evaluation.mesh.accuracy < 1e-4
    written = json.loads((tmp_path / "evaluation.json").read_text())
    assert written["frames"] == written["frames_with_truth"] == 50 and written["mesh"]["protocol"] == "seen"
    assert "rpe_1" in written and "rpe_30" in written
    assert (tmp_path / "trajectory.png").stat().st_size > 5000 and (tmp_path / "error.png").stat().st_size > 5000
    assert (written["mesh"]["near"], written["mesh"]["far"], written["mesh"]["range_from"]) == (0.1, 10, "protocol")
    assert table(evaluation).row_count == 15  # with the largest jump and the RPE over one frame


def test_the_range_of_a_result_folders_recording(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    perfect_result(tmp_path, np.eye(4))
    write_keyframes(tmp_path, KeyframeRecord(CAMERA, np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 4, 4))))
    image = np.linspace(0.8, 2.2, 64 * 48, dtype=np.float32).reshape(48, 64)
    found = evaluate_folder(tmp_path, recording=DepthImages([image] * 50), **FEW).mesh
    assert found is not None and found.range_from == "recording" and found.samples == 20_000 and found.views <= 20
    assert (found.near, found.far) == (pytest.approx(0.8, abs=0.01), pytest.approx(2.2, abs=0.01))
    assert json.loads((tmp_path / "evaluation.json").read_text())["mesh"]["far"] == found.far
    # Truth in files and a recording that is gone
    save_tum(tmp_path / "truth.txt", Trajectory(np.arange(50) / 10, turning()))
    room().export(tmp_path / "truth.ply")
    write_config(tmp_path, FAST, RecordingSource(str(tmp_path / "gone")))
    alone = evaluate_folder(tmp_path, gt=tmp_path / "truth.txt", gt_mesh=tmp_path / "truth.ply", **FEW).mesh
    assert alone is not None and (alone.near, alone.far, alone.range_from) == (0.1, 10, "protocol")
    assert "no depth image of its recording can be read" in caplog.text and "gone: no such file" in caplog.text


def test_incomplete_result_folders(tmp_path: Path) -> None:
    truth = Trajectory(np.arange(50) / 10, turning())
    expected: list[tuple[Path, str]] = [(tmp_path / "none", "no such folder"), (tmp_path, "no trajectory.txt")]
    for folder, message in expected:
        with pytest.raises(ResultError, match=message):
            evaluate(folder, gt_trajectory=truth)
    perfect_result(tmp_path, np.eye(4))
    with pytest.raises(ResultError, match="no camera"):
        evaluate(tmp_path, gt_trajectory=truth, gt_mesh=room())
    (tmp_path / "mesh.ply").unlink()
    with pytest.raises(ResultError, match=r"mesh\.ply: no such file"):
        evaluate(tmp_path, gt_trajectory=truth, gt_mesh=room(), camera=CAMERA)


def test_a_mesh_of_which_nothing_is_seen_leaves_the_trajectory_s_error(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    perfect_result(tmp_path, np.eye(4))
    room().apply_translation([100.0, 0.0, 0.0]).export(tmp_path / "mesh.ply")
    truth = Trajectory(np.arange(50) / 10, turning())
    evaluation = evaluate(tmp_path, gt_trajectory=truth, gt_mesh=room(), camera=CAMERA)
    assert evaluation.mesh is None and evaluation.ate.translation.max < 1e-6
    assert "the mesh is not evaluated: nothing of the reconstruction is visible" in caplog.text
    assert "mesh" not in json.loads((tmp_path / "evaluation.json").read_text())


def test_distance_to_a_triangle_by_hand() -> None:
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    needle = np.array([[0.0, 0, 0], [1e-17, 0, 0], [0, 0, 1]])  # no area: a line along z
    points = np.array([[0.2, 0.2, -0.5], [0.5, -0.3, 0.4], [-3, -4, 0], [1, 1, 0], [0.3, 0.4, 0.5]])
    expected = [0.5, 0.5, 5.0, 0.5**0.5, 0.5]  # above the face, an edge, a corner, the long edge; the line, 0.3 and 0.4 aside
    candidates = np.array([[0], [0], [0], [0], [1]])
    assert nearest_triangle(points, np.stack([flat, needle]), candidates)[0] == pytest.approx(expected)
    distance, nearest = nearest_triangle(np.array([[0.3, 0.4, 0.6]]), np.stack([flat, needle]), np.array([[0, 1]]))
    assert distance == pytest.approx(0.5) and nearest == [1]


@pytest.mark.parametrize("content", [b"", b"ply\nnonsense", b"\x00\x01\x02"])
def test_damaged_meshes(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "mesh.ply").write_bytes(content)
    with pytest.raises(IdfSlamError, match=r"mesh\.ply"):
        load_mesh(tmp_path / "mesh.ply")


def test_the_command_offers_every_protocol() -> None:
    assert get_args(get_args(get_type_hints(Eval)["protocol"])[0]) == tuple(PROTOCOLS)
