"""From where a picture shows a place: a room from above, a part of one from where the cameras saw it."""

import numpy as np
import trimesh

from idfslam.pictures.direction import best_direction, shown

UP = np.array([0.0, 0.0, 1.0])


def test_a_part_of_a_room_is_shown_from_where_it_was_seen() -> None:
    """A wall and things before it, all seen from -y: from there, not from behind, whatever the winding of the faces."""
    wall = trimesh.creation.box((4.0, 0.01, 2.0))
    things = [trimesh.creation.box((0.3, 0.3, 0.3), trimesh.transformations.translation_matrix([x, -1, -0.5])) for x in (-1.0, 0.0, 1.2)]
    mesh = trimesh.util.concatenate([wall, *things])
    eyes = np.array([[0.0, -4.0, 0.3], [0.1, -4.0, 0.3]])
    direction = best_direction(mesh, eyes, UP)
    assert direction @ [0, -1, 0] > 0.85
    assert 0.3 < direction[2] < 0.6


def test_a_room_seen_from_its_middle_is_shown_from_above() -> None:
    """The floor is larger than the walls."""
    room = trimesh.creation.box((6.0, 5.0, 1.5)).subdivide().subdivide()
    eyes = np.array([[x, y, 0.3] for x in (-1.0, 1.0) for y in (-1.0, 1.0)])
    direction = best_direction(room, eyes, UP)
    np.testing.assert_allclose(np.linalg.norm(direction), 1)
    assert direction[2] > 0.7
    above, below = shown(room, eyes, np.array([[0, 0, 1.0], [0, 0, -1.0]]))
    assert above > 15
    assert below > 5  # the ceiling
