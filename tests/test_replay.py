"""Which stored keyframes are replayed (Sec. IV-C), and which first: those that the map has yet to learn again. Before a wall."""

import torch

from helpers.flat_wall import PAPER, insert, keyframe, wall_frames, wall_graph
from idfslam.config import KeyframeConfig
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.replay import Replay
from idfslam.slam.back_end.relearn_queue import RelearnQueue


def replay(graph: KeyframeGraph, config: KeyframeConfig = PAPER) -> Replay:
    return Replay(config, graph, torch.Generator().manual_seed(0))


def indices(keyframes: list[Keyframe]) -> list[int]:
    return [keyframe.index for keyframe in keyframes]


def test_replay_draws_only_what_is_not_connected_and_at_most_so_many() -> None:
    # 20 places 1.7 m apart: a share of 0.47 with the next (connected), of -0.06, so none, with the one after.
    graph = wall_graph(places=tuple(1.7 * i for i in range(20)))
    assert len(graph.keyframes) == 20
    newest, drawer = graph.keyframes[-1], replay(graph)
    assert newest.covisible == {18}
    seen = set()
    for _ in range(30):
        drawn = indices(drawer.draw(newest))
        assert len(drawn) == len(set(drawn)) == 10
        assert not {18, 19} & set(drawn)
        seen |= set(drawn)
    assert seen == set(range(18))
    few = wall_graph(places=(0.0, 1.7, 3.4))
    assert indices(replay(few).draw(few.keyframes[-1])) == [0]


def test_replay_of_connected_keyframes_is_apart() -> None:
    config = KeyframeConfig(cull=0.5, replay=0, replay_connected=2)
    graph = wall_graph(config, places=(0.0, 1.7, 3.4))
    assert indices(replay(graph, config).draw(graph.keyframes[-1])) == [1]


def test_a_culled_frame_replays_by_what_it_sees_itself() -> None:
    frames = wall_frames(places=(0.0, 1.7, 3.4))
    culled = keyframe(3, 3.5)  # shares 0.97 with the last, 0.44 with the one before
    assert not insert(frames, culled)
    assert culled.covisible == {1, 2}
    assert indices(replay(frames.graph).draw(culled)) == [0]


def test_what_a_loop_has_moved_is_replayed_first_and_the_nearest_of_it() -> None:
    config = KeyframeConfig(cull=0.5, replay=1, replay_connected=1)
    graph = wall_graph(config, places=(0.0, 1.7, 3.4, 5.1))
    drawer, queue, newest = replay(graph, config), RelearnQueue(1), graph.keyframes[-1]
    assert drawer.count == 2
    queue.add(graph.keyframes[i] for i in (0, 1, 3))
    assert indices(queue.nearest(newest, graph.keyframes, drawer.count)) == [1, 0]  # the newest itself is learnt anyway
    queue.trained(graph.keyframes[:2])
    assert queue.nearest(newest, graph.keyframes, drawer.count) == []
    assert sorted(indices(drawer.draw(newest))) in ([0, 2], [1, 2])


def test_each_waits_for_so_many_updates() -> None:
    graph = wall_graph(places=(0.0, 1.7, 3.4))
    queue, (first, second, _) = RelearnQueue(2), graph.keyframes
    queue.add([first, second])
    queue.trained([first, graph.keyframes[2]])
    assert first in queue and second in queue and graph.keyframes[2] not in queue
    again = RelearnQueue(2)
    again.restore(queue.state())
    for each in (queue, again):
        each.trained([first])
        assert first not in each and second in each
        each.trained([second])
        each.trained([second])
        assert second not in each


def test_the_generator_is_kept() -> None:
    graph = wall_graph(places=tuple(1.7 * i for i in range(20)))
    once, again = replay(graph), replay(graph)
    once.sample(3)
    again.restore(once.state())
    assert indices(once.sample(5)) == indices(again.sample(5))
    assert len(once.sample(50)) == 20
