"""People and things that move in generated recordings: their masks, their static twin, their paths, and the names that open them."""

from functools import cache

import numpy as np
import pytest

from idfslam.datasets import open_recording
from idfslam.datasets.generated import kind_of
from idfslam.datasets.generated.corridor import SyntheticCorridor
from idfslam.datasets.generated.faults import Faults
from idfslam.datasets.generated.handheld import handheld_room
from idfslam.datasets.generated.hard_cases import HARD_CASE_SECONDS, HARD_CASES
from idfslam.datasets.generated.movers import MOVERS, PEOPLE
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.scenes.floor_path import FloorPath
from idfslam.scenes.furniture import SceneBuilder
from idfslam.scenes.moved_things import OpenedDoor, eased
from idfslam.scenes.moving_scene import MovingScene
from idfslam.scenes.walking_figure import WalkingFigure

SIZE = {"width": 160, "height": 120}


@cache
def room(movers: str | None, *, noise: bool = False) -> SyntheticRoom:
    return SyntheticRoom(0, 300, **SIZE, movers=movers, noise=noise)


def standing() -> FloorPath:
    """At (1, 2) for 1 s, then 2 m along x within 2 s, then there."""
    times, places = np.array([0.0, 1, 3, 6]), np.array([[1.0, 2], [1, 2], [3, 2], [3, 2]])
    return FloorPath(times, places, lambda t: np.full((len(t), 2), 100.0))


@pytest.mark.parametrize("noise", [False, True])
def test_the_twin_without_movers_has_the_same_motion_and_the_same_pixels_elsewhere(noise: bool) -> None:
    people, twin = room(PEOPLE, noise=noise), room(None, noise=noise)
    np.testing.assert_array_equal(people.ground_truth, twin.ground_truth)
    i, moving = 75, people.moving(75)
    a, b = people[i], twin[i]
    assert 0.2 < moving.mean() < 0.6
    assert not twin.moving(i).any()
    far = np.ones_like(moving)  # noise takes a reading from up to two pixels away, and colour is mixed at edges
    v, u = np.nonzero(moving)
    for dv in range(-3, 4):
        for du in range(-3, 4):
            far[(v + dv).clip(0, 119), (u + du).clip(0, 159)] = False
    assert far.mean() > 0.2
    np.testing.assert_array_equal(a.colour[far], b.colour[far])
    np.testing.assert_array_equal(a.depth[far], b.depth[far])


def test_masks_are_where_depth_is_less_than_without() -> None:
    people, twin = room(PEOPLE), room(None)
    for i in (0, 60, 140):
        np.testing.assert_array_equal(people.moving(i), people[i].depth < twin[i].depth)
        assert (people[i].depth <= twin[i].depth).all()


def test_people_are_seen_from_the_first_frame_and_fill_up_to_half_of_the_view() -> None:
    share = [room(PEOPLE).moving(i).mean() for i in range(0, 300, 5)]
    assert share[0] > 0.1
    assert 0.4 < max(share) < 0.6
    assert len(room(PEOPLE)._scene.bodies) == 3  # type: ignore[union-attr]


def test_shorter_recordings_begin_alike() -> None:
    short = SyntheticRoom(0, 30, **SIZE, movers=PEOPLE)
    np.testing.assert_array_equal(short[29].depth, room(PEOPLE)[29].depth)


def test_things_are_moved_and_left() -> None:
    scene = room(MOVERS)._scene
    assert isinstance(scene, MovingScene)
    chair, door = scene.bodies[1:3]
    before, after, later = ([shape[4:7] for shape in drawn(body, t)] for body, t in ((chair, 2.9), (chair, 6.0), (chair, 9.0)))
    assert np.linalg.norm(np.mean(after, 0) - np.mean(before, 0)) > 0.3
    np.testing.assert_allclose(after, later, atol=1e-3)
    assert isinstance(door, OpenedDoor)
    panels = [drawn(door, t)[0] for t in (0.0, door.end + 1)]
    turned = panels[0][7:16].reshape(3, 3).T @ panels[1][7:16].reshape(3, 3)
    assert np.rad2deg(np.arccos((np.trace(turned) - 1) / 2)) == pytest.approx(80)


def drawn(body: object, seconds: float) -> list[np.ndarray]:
    scene = SceneBuilder(np.random.default_rng(0))
    body.draw(scene, seconds)  # type: ignore[attr-defined]
    return scene.shapes


def test_surface_leaves_movers_out() -> None:
    a, b = room(MOVERS).surface(), room(None).surface()
    np.testing.assert_array_equal(a.vertices, b.vertices)


# ----- bodies


def test_path_stands_and_walks() -> None:
    path = standing()
    assert path.place(0.5) == pytest.approx((1, 2), abs=1e-4)
    assert path.place(2.0) == pytest.approx((2, 2), abs=0.01)
    assert path.place(4.0) == pytest.approx((3, 2), abs=1e-4)
    assert path.heading(0.0) == pytest.approx(0, abs=1e-6)  # where it is going to go
    assert path.distance(5.0) == pytest.approx(2, abs=0.01)
    assert (path.speed(0.5), path.speed(4.0)) == pytest.approx((0, 0), abs=1e-3)


def test_path_keeps_away_from_the_camera() -> None:
    path = FloorPath(np.array([0.0, 4]), np.array([[-2.0, 0.1], [2, 0.1]]), lambda t: np.zeros((len(t), 2)))
    assert min(np.hypot(*path.place(t)) for t in np.linspace(0, 4, 200)) > 0.6  # rounding cuts the corner of one who comes straight at it


def test_figure_stands_upright_and_swings_its_legs() -> None:
    figure = WalkingFigure(SceneBuilder(np.random.default_rng(0)), standing(), 1.8)
    still, walking = np.array(drawn(figure, 0.5)), np.array(drawn(figure, 2.0))
    assert len(still) == len(walking) == 25
    np.testing.assert_array_equal(still[:, [0, 1, 2, 3, 16]], walking[:, [0, 1, 2, 3, 16]])  # the same shapes
    assert still[3, 4:7] == pytest.approx((1 + 0.01 * 1.8, 2, 0.925 * 1.8), abs=1e-4)  # the head
    feet = still[still[:, 0] == 0]
    assert feet[:, 6] == pytest.approx(np.full(2, 1.8 * (0.52 - 0.25 - 0.235 - 0.01)), abs=1e-3)
    assert np.ptp(feet[:, 4]) < 1e-3
    assert np.ptp(walking[walking[:, 0] == 0][:, 4]) > 0.1


def test_easing() -> None:
    assert [eased(t, 1, 3) for t in (0, 1, 2, 3, 9)] == [0, 0, 0.5, 1, 1]


# ----- names


def test_names() -> None:
    names = ["synthetic:people", "synthetic:3:movers:kinect", "synthetic:3:people:handheld-time", "corridor:2:people:kinect:2laps"]
    assert [kind_of(name) for name in names] == ["synthetic"] * 3 + ["corridor"]
    assert [kind_of(name) for name in ("synthetic:persons", "synthetic:kinect:people")] == [None] * 2
    assert open_recording("synthetic:3:movers:kinect", frames=2).name == "synthetic-3-movers-noise"


def test_corridor_and_handheld_have_them_too() -> None:
    corridor = SyntheticCorridor(0, **SIZE, movers=PEOPLE)
    assert max(corridor.moving(i).mean() for i in range(0, 300, 30)) > 0.1
    shaken = handheld_room(Faults.named(None), 0, 40, **SIZE, movers=PEOPLE)
    assert shaken.moving(20).mean() > 0.1
    still = handheld_room(Faults.named(None), 0, 40, **SIZE)
    assert np.abs(shaken[20].colour - still[20].colour).mean() > 0.02
    np.testing.assert_array_equal(shaken.exact(20).depth[~shaken.moving(20)], still.exact(20).depth[~shaken.moving(20)])


# ----- hard cases


@cache
def hard_case(name: str) -> SyntheticRoom:
    return SyntheticRoom(0, 180, **SIZE, movers=name)


def shares(name: str) -> list[float]:
    """Of every tenth image, what the bodies cover."""
    return [float(hard_case(name).moving(i).mean()) for i in range(0, 180, 10)]


def test_one_who_crosses_fills_half_of_the_view_and_is_gone_before_and_after() -> None:
    share = shares("crossing")
    assert share[0] == share[-1] == 0.0
    assert 0.3 < max(share) < 0.6


def test_one_who_pauses_stands_for_60_frames() -> None:
    scene = hard_case("pausing")._scene
    assert isinstance(scene, MovingScene)
    path = scene.bodies[0].path  # type: ignore[attr-defined]
    stands = [path.place(t) for t in (2.2, 3.0, 3.8)]
    np.testing.assert_allclose(stands, [stands[0]] * 3, atol=0.02)
    assert np.linalg.norm(np.subtract(path.place(5.9), stands[0])) > 0.4
    assert min(shares("pausing")[7:12]) > 0.1


@pytest.mark.parametrize("name", ["swivelling", "opening"])
def test_a_thing_moves_in_its_place(name: str) -> None:
    scene = hard_case(name)._scene
    assert isinstance(scene, MovingScene)
    before, start, end, after = (np.array([shape[4:7] for shape in drawn(scene.bodies[0], t)]) for t in (0.0, 2.0, 4.0, HARD_CASE_SECONDS))
    np.testing.assert_allclose(before, start)
    np.testing.assert_allclose(end, after)
    assert np.linalg.norm(end - start, axis=1).max() > 0.1
    assert max(shares(name)) > 0.02


def test_there_are_five_hard_cases() -> None:
    assert list(HARD_CASES) == ["crossing", "pausing", "swivelling", "opening", "pair"]
    assert max(shares("pair")) > 0.15
    assert len(hard_case("pair")._scene.bodies) == 2  # type: ignore[union-attr]
