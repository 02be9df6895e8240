"""Presets against the paper's values, and config files: precedence, round trip, mistakes."""

import dataclasses
from pathlib import Path
from typing import Any

import pytest
import yaml

from idfslam.config import FAST, PAPER, PRESETS, PRETRAIN, Config, check, dump, load, preset
from idfslam.config.fields import UserOption, bounds, field_types, is_user_option, meanings
from idfslam.config.yaml_file import RENAMED
from idfslam.errors import ConfigError

PAPER_VALUES = {
    # Sec. VI-A
    "mapper.pixels": 1024,  # B
    "field.truncation": 0.10,  # tr = 10 cm
    "keyframes.replay": 10,  # N_rep
    "keyframes.cull": 0.5,  # sigma_cull
    "keyframes.covisible": 0.3,  # sigma_covis
    "tracker.matches": 200,  # K
    "finetune.keyframes": 10,  # N_kf
    "mapper.learning_rate": 0.005,  # eta_mlp, no decay
    "mapper.pose_learning_rate": 0.005,  # eta_pose
    "mapper.pose_decay": 0.7,
    "mapper.pose_decay_every": 10,
    "finetune.learning_rate": 1e-4,  # eta_conv
    # Sec. IV-A: one MLP of 8 layers, 256 wide, on positional encoding
    "field.encoding": "positional",
    "field.layers": 8,
    "field.width": 256,
    # Sec. IV-B and IV-C
    "mapper.supervision": "rendering",
    "mapper.active_sampling": True,
    "mapper.cells": 8,  # 8 x 8 grid
    "mapper.pose_optimisation": True,
    # Sec. V: 4 x 4 grid, finetuning
    "tracker.grid": 4,
    "finetune.enabled": True,
}


def value(config: Config, name: str) -> Any:
    section, key = name.split(".")
    return getattr(getattr(config, section), key)


@pytest.mark.parametrize("name", PAPER_VALUES)
def test_paper_preset_holds_the_papers_value(name: str) -> None:
    assert value(PAPER, name) == PAPER_VALUES[name]


def test_paper_preset_takes_the_trackers_pose() -> None:
    assert PAPER.front_end == "registration"
    assert not PAPER.refine


def test_paper_preset_takes_144_samples_a_ray() -> None:
    # S_p = 144: 128 stratified + 16 around the rendered surface
    assert PAPER.mapper.samples + PAPER.mapper.importance_samples == 144


def test_presets_know_their_names_and_can_be() -> None:
    for name, config in PRESETS.items():
        assert preset(name) is config
        assert config.preset == name
        assert check(config) is config


def test_dump_and_load_return_the_same_config(tmp_path: Path) -> None:
    config = dataclasses.replace(PAPER, seed=7, tracker=dataclasses.replace(PAPER.tracker, weights=Path("some/weights.safetensors")))
    path = tmp_path / "config.yaml"
    path.write_text(yaml.safe_dump(dump(config)))
    assert load(path) == config


def test_a_file_of_few_lines_changes_these_alone(tmp_path: Path) -> None:
    path = tmp_path / "few.yaml"
    path.write_text("preset: paper\nmapper: {pixels: 256, learning_rate: 1}\n")
    config = load(path)
    assert config == dataclasses.replace(PAPER, mapper=dataclasses.replace(PAPER.mapper, pixels=256, learning_rate=1.0))
    assert load(path, base="fast").mapper == dataclasses.replace(FAST.mapper, pixels=256, learning_rate=1.0)


def test_what_a_run_adds_to_its_config_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "config.yaml"
    path.write_text("seed: 3\nrecording: {path: room}\nversions: {torch: 2.6.0}\n")
    assert load(path) == dataclasses.replace(FAST, seed=3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mapper: {pixel: 3}", "unknown key 'pixel'"),
        ("maper: {pixels: 3}", "unknown key 'maper'"),
        ("mapper: 3", "'mapper' is 3, expected a section"),
        ("mapper: {pixels: many}", "'pixels' is 'many', expected a value like"),
        ("mapper: {pixels: true}", "'pixels' is True"),
        ("mapper: {precision: fp8}", "choose one of auto, fp32, bf16"),
        ("mapper: {pixels: 0}", "mapper.pixels is 0, expected at least 1"),
        ("hold_out: 1", "hold_out is 1, expected 0 or at least 2"),
        ("mapper: {redraw: 0}", "mapper.redraw is 0, expected at least 1"),
        ("refinement: {seconds: 0}", "refinement.seconds is 0.0, expected more than 0"),
        ("mapper: {learning_rate: .nan}", "mapper.learning_rate is nan, expected a finite number"),
        ("mapper: {iterations: -1}", "mapper.iterations is -1"),
        ("field: {truncation: 0}", "field.truncation is 0.0, expected more than 0"),
        ("tracker: {weights: 3}", "expected a path"),
        ("preset: slow", "preset 'slow' does not exist; choose one of fast, paper"),
        ("- 1", "found list, expected a mapping"),
        ("a: [", "is not YAML"),
        ("!!python/object/apply:os.getcwd []", "is not YAML"),
    ],
)
def test_mistakes_in_a_file_get_one_clear_line(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "config.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no-such"):
        load(tmp_path / "no-such.yaml")


@pytest.mark.parametrize("old", RENAMED)
def test_a_key_of_an_earlier_version_is_refused_with_its_new_name(old: str, tmp_path: Path) -> None:
    section, key = old.split(".")
    path = tmp_path / "config.yaml"
    path.write_text(f"{section}: {{{key}: 1}}\n")
    with pytest.raises(ConfigError, match=f"unknown key '{old}'; its name is now '{RENAMED[old]}'"):
        load(path)


def test_renamed_keys_lead_to_keys_that_exist() -> None:
    for old, new in RENAMED.items():
        section, _, key = new.rpartition(".")
        assert key in field_types(type(getattr(FAST, section) if section else FAST))
        section, key = old.split(".")
        assert key not in field_types(type(getattr(FAST, section)))


def test_bounds_are_stated_by_the_fields() -> None:
    mapper, mesh = field_types(type(FAST.mapper)), field_types(type(FAST.mesh))
    assert [str(bound) for bound in bounds(mapper["pixels"])] == ["at least 1"]
    assert [str(bound) for bound in bounds(mesh["resolution"])] == ["more than 0"]
    assert bounds(mapper["every"]) == []
    with pytest.raises(ConfigError, match=r"crop is \(96, 0\), expected at least 1"):
        check(dataclasses.replace(PRETRAIN, crop=(96, 0)))


def test_user_options_are_marked_on_the_fields() -> None:
    assert is_user_option(field_types(Config)["seed"])
    assert is_user_option(UserOption[bool])
    assert not is_user_option(field_types(type(FAST.mapper))["pixels"])


def test_every_field_has_a_meaning() -> None:
    sections = [
        PRETRAIN,
        FAST,
        *(getattr(FAST, f.name) for f in dataclasses.fields(FAST) if dataclasses.is_dataclass(getattr(FAST, f.name))),
    ]
    for section in sections:
        names = {f.name for f in dataclasses.fields(section) if not dataclasses.is_dataclass(getattr(section, f.name))}
        assert set(meanings(type(section))) == names
        assert all(text.endswith(".") for text in meanings(type(section)).values())
