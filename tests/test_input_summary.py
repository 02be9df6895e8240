"""Where the values of a recording come from is known and told."""

from pathlib import Path

import numpy as np

from helpers.box_room import write_box_recording
from idfslam.datasets import Kidnapped, open_recording
from idfslam.datasets.cameras.calibration import Calibration, assumed_scale
from idfslam.datasets.provenance import Provenance, provenance


def test_a_folder_names_its_sources(tmp_path: Path) -> None:
    recording = open_recording(write_box_recording(tmp_path / "r"))
    expected = Provenance(str(tmp_path / "r" / "intrinsics.txt"), 1000, depth="assumed", stamps="assumed")
    assert provenance(recording) == provenance(Kidnapped(recording, times=1, frames=1)) == expected


def test_what_the_user_states_is_named(tmp_path: Path) -> None:
    folder = write_box_recording(tmp_path / "r")
    np.savetxt(folder / "timestamps.txt", np.arange(len(list((folder / "rgb").iterdir()))) / 10)
    part = provenance(open_recording(folder, camera={"fx": 90.0}, depth_scale=1000))
    assert part == Provenance(f"{folder / 'intrinsics.txt'} with fx of the command line", 1000, stamps="timestamps.txt")
    whole = provenance(open_recording(folder, camera={"fx": 90.0, "fy": 90.0, "cx": 40.0, "cy": 30.0}))
    assert whole == Provenance("the command line", 1000, depth="assumed", stamps="timestamps.txt")


def test_generated_recordings_have_a_provenance() -> None:
    assert provenance(open_recording("synthetic:0", frames=2)) == Provenance("generated", stamps="generated")
    assert provenance(object()) is None


def test_a_stated_depth_scale_is_not_assumed() -> None:
    file = Calibration(1, 1, 1, 1, depth_scale=5000, source="file")
    assert file.over(assumed_scale(1000)) == file
    assert Calibration(1, 1, 1, 1).over(assumed_scale(1000, "TUM layout")).assumed == "TUM layout"
    assert Calibration(depth_scale=1).over(assumed_scale(1000)).over(file) == Calibration(1, 1, 1, 1, depth_scale=1, source="file")
