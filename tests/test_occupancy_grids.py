"""NICE-SLAM's map: levels and stages, tables that grow, features in view, and decoders from a file."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from helpers.flat_wall import at, keyframe
from idfslam.config import NICE, OccupancyGridsConfig
from idfslam.errors import ConfigError
from idfslam.mapping.joint.grids_map import GridsMap, features_in_view
from idfslam.mapping.joint.occupancy_grids import LearningStage, OccupancyGrids, levels_of
from idfslam.mapping.training_view import TrainingView
from idfslam.pretraining.occupancy_decoders import DecoderTraining, labelled_points, save_decoders, train, views_of

SMALL = OccupancyGridsConfig(table_log2=8, table_log2_max=9)


def grids(config: OccupancyGridsConfig = SMALL) -> OccupancyGrids:
    torch.manual_seed(0)
    return OccupancyGrids(config)


def test_the_networks_of_the_paper() -> None:
    field = grids()
    assert [float(field.grid(level).cells) for level in ("coarse", "middle", "fine", "colour")] == pytest.approx([2, 0.32, 0.16, 0.16])
    assert [layer.in_features for layer in field.middle_decoder.layers] == [93, 32, 32, 32 + 93, 32]
    assert [layer.in_features for layer in field.fine_decoder.features] == [64] * 5  # the middle level's features join
    assert [layer.in_features for layer in field.coarse_decoder.layers] == [32, 32, 32, 64, 32]
    assert field.colour_decoder.output.out_features == 3
    assert float(field.grid("fine").tables.detach().std()) == pytest.approx(1e-4, rel=0.1)
    assert float(field.grid("middle").tables.detach().std()) == pytest.approx(1e-2, rel=0.1)


def test_occupancy_is_the_sigmoid_of_ten_times_both_levels() -> None:
    field, points = grids(), torch.rand(7, 3)
    middle = field.middle_decoder(points, field.grid("middle")(points))
    fine = field.fine_decoder(points, torch.cat([field.grid("fine")(points), field.grid("middle")(points)], -1))
    torch.testing.assert_close(field.occupancy(points, points, LearningStage.MIDDLE)[0], torch.sigmoid(10 * middle[:, 0]))
    torch.testing.assert_close(field.occupancy(points, points)[0], torch.sigmoid(10 * (middle + fine)[:, 0]))
    torch.testing.assert_close(field.sdf(points), 1 - 2 * field.occupancy(points, points)[0])
    torch.testing.assert_close(field(points)[0], field.sdf(points))


@pytest.mark.parametrize("stage", list(LearningStage))
def test_a_stage_moves_its_levels_alone(stage: LearningStage) -> None:
    field, points = grids(), torch.rand(50, 3)
    occupancy, colour = field.occupancy(points, points, stage)
    (occupancy.sum() + colour.sum()).backward()
    moved = {level for level in ("coarse", "middle", "fine", "colour") if bool(field.grid(level).gradient.any())}
    assert moved == set(levels_of(stage))


def test_features_elsewhere_collect_no_gradient() -> None:
    field, points = grids(), torch.tensor([[0.1, 0.1, 0.1], [3.1, 3.1, 3.1]])
    field.occupancy(points, points, LearningStage.MIDDLE, learnable=lambda p: p[:, 0] < 1)[0].sum().backward()
    here, both = field.grid("middle").gradient.clone(), grids()
    both.occupancy(points[:1], points[:1], LearningStage.MIDDLE)[0].sum().backward()
    torch.testing.assert_close(here, both.grid("middle").gradient)


def test_features_in_view() -> None:
    # A wall 2 m ahead: up to 2.5 m behind it counts, and what is within 0.5 m of the camera, also behind it.
    view = keyframe(0, 0.0)
    points = torch.tensor([[0.0, 0, 1.9], [0, 0, 2.4], [0, 0, 2.6], [0, 0, -0.4], [0, 0, -0.6], [2.0, 0, 2.0]])
    assert features_in_view(TrainingView(view), points).tolist() == [True, True, False, True, False, False]
    view.T_wk = at(2.0)
    assert features_in_view(TrainingView(view), points).tolist() == [False, False, False, False, False, True]


def test_a_table_that_fills_up_is_doubled() -> None:
    field, points = grids(), torch.rand(20, 3)
    before = field.occupancy(points, points)
    entries = torch.ones(256, dtype=torch.bool)
    field.mark_used("fine", entries & (torch.arange(256) < 200))
    assert field.grid("fine").tables.shape == (1, 256, 32)
    field.mark_used("fine", entries)  # 256 of 256 > 0.8
    assert field.grid("fine").tables.shape == (1, 512, 32)
    assert not field.fine_used.any()
    after = field.occupancy(points, points)
    assert torch.equal(before[0], after[0]) and torch.equal(before[1], after[1])  # the same function
    field.mark_used("fine", torch.ones(512, dtype=torch.bool))
    assert field.grid("fine").tables.shape == (1, 512, 32)  # the largest size


def test_rates_of_the_stages() -> None:
    map = GridsMap(replace(NICE, device="cpu", occupancy_grids=SMALL), torch.device("cpu"), torch.Generator())
    adam = map._optimiser()

    def rates(stage: LearningStage, factor: float = 1.0) -> dict[str, float]:
        map._set_rates(adam, stage, factor)
        return {group["name"]: round(group["lr"], 6) for group in adam.param_groups}

    assert rates(LearningStage.MIDDLE) == {"coarse": 0.001, "middle": 0.1, "fine": 0, "colour": 0, "decoder": 0}
    assert rates(LearningStage.COLOUR) == {"coarse": 0.001, "middle": 0.005, "fine": 0.005, "colour": 0.005, "decoder": 0.005}
    assert rates(LearningStage.MIDDLE, 5.0)["middle"] == 0.5
    assert [map._stage(i / 60) for i in (0, 24, 25, 36, 37, 59)] == [
        *(LearningStage.MIDDLE, LearningStage.MIDDLE, LearningStage.FINE, LearningStage.FINE, LearningStage.COLOUR, LearningStage.COLOUR)
    ]


def test_decoders_are_loaded_and_frozen() -> None:
    map = GridsMap(replace(NICE, device="cpu", occupancy_grids=SMALL), torch.device("cpu"), torch.Generator())
    assert not any(p.requires_grad for p in map.field.parameters())
    with map.field.learning():
        map._freeze_decoders(colour=False)
        learnt = {name.split(".")[0] for name, p in map.field.named_parameters() if p.requires_grad}
    assert learnt == {"coarse", "middle", "fine", "colour", "colour_decoder"}


def test_decoders_of_another_size_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"size mismatch.*; expected decoders of the size that occupancy_grids states"):
        grids(replace(SMALL, width=16)).load_decoders()


def test_damaged_decoders_are_refused(tmp_path: Path) -> None:
    (tmp_path / "w.safetensors").write_bytes(b"nothing")
    with pytest.raises(ConfigError, match="expected decoders"):
        grids().load_decoders(tmp_path / "w.safetensors")


# training

TINY = DecoderTraining(rooms=(101,), views=3, episodes=2, steps=3, points=60, window=2)


def test_points_before_and_behind_a_reading() -> None:
    views = views_of(101, 2)
    points, occupied = labelled_points(views, torch.eye(4), 800, torch.Generator().manual_seed(0))
    assert points.shape == (800, 3)
    assert 0.3 < float(occupied.mean()) < 0.45  # three quarters lie around readings, half of these behind


def test_training_repeats_and_is_read_back(tmp_path: Path) -> None:
    (field, losses), (again, _) = train(TINY), train(TINY)
    assert len(losses) == 2
    save_decoders(tmp_path / "a.safetensors", field, TINY)
    save_decoders(tmp_path / "b.safetensors", again, TINY)
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    other = grids()
    other.load_decoders(tmp_path / "a.safetensors")
    assert torch.equal(other.middle_decoder.output.weight, field.middle_decoder.output.weight)
    weights = load_file(tmp_path / "a.safetensors")
    assert {name.split(".")[0] for name in weights} == {"coarse_decoder", "middle_decoder", "fine_decoder"}
    save_file({k: v for k, v in weights.items() if "coarse" not in k}, tmp_path / "c.safetensors")
    with pytest.raises(ConfigError, match="Missing key"):
        other.load_decoders(tmp_path / "c.safetensors")
