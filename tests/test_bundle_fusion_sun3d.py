"""The layouts of BundleFusion and SUN3D, on small recordings written here."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.recordings import HEIGHT, WIDTH, colour_image, depth_image, pose
from idfslam.datasets import open_recording
from idfslam.errors import RecordingError
from idfslam.geometry.camera import Camera


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_bundle_fusion(suffix: str, tmp_path: Path) -> None:
    for i in range(3):
        cv2.imwrite(str(tmp_path / f"frame-{i:06d}.color.{suffix}"), colour_image(i))
        cv2.imwrite(str(tmp_path / f"frame-{i:06d}.depth.png"), depth_image(2000))
        np.savetxt(tmp_path / f"frame-{i:06d}.pose.txt", pose(i) if i else np.full((4, 4), -np.inf))
    info = [
        "m_versionNumber = 4", "m_sensorName = StructureSensor", f"m_colorWidth = {WIDTH}", f"m_colorHeight = {HEIGHT}",
        "m_depthShift = 2000", "m_calibrationColorIntrinsic = 15 0 7.5 0 0 15 5.5 0 0 0 1 0 0 0 0 1",
    ]  # fmt: skip
    (tmp_path / "info.txt").write_text("\n".join(info))
    recording = open_recording(tmp_path)
    assert len(recording) == 3 and recording.camera == Camera(WIDTH, HEIGHT, 15.0, 15.0, 7.5, 5.5)
    assert recording[1].depth[6, 8] == pytest.approx(1)
    assert recording.ground_truth is not None and np.isnan(recording.ground_truth[0]).all()
    np.testing.assert_allclose(recording.ground_truth[2], pose(2), atol=1e-6)
    (tmp_path / "info.txt").write_text("m_colorWidth = wide")
    with pytest.raises(RecordingError, match=r"info\.txt: .*expected m_colorWidth, m_colorHeight and m_calibrationColorIntrinsic"):
        open_recording(tmp_path)


def test_sun3d(tmp_path: Path) -> None:
    """Depth comes 12 ms after colour; its frames have numbers of their own."""
    for folder in ("image", "depth"):
        (tmp_path / folder).mkdir()
    for i in range(4):
        cv2.imwrite(str(tmp_path / f"image/{i + 1:07d}-{33_333 * i:012d}.jpg"), colour_image(i))
        raw = depth_image(1000 + i)
        cv2.imwrite(str(tmp_path / f"depth/{i + 3:07d}-{33_333 * i + 12_000:012d}.png"), raw << 3 | raw >> 13)
    (tmp_path / "intrinsics.txt").write_text("15 0 7.5\n0 15 5.5\n0 0 1\n")
    recording = open_recording(tmp_path)
    assert len(recording) == 4
    np.testing.assert_allclose(recording.timestamps, 0.033333 * np.arange(4))
    for i in range(4):
        assert recording[i].depth[6, 8] == pytest.approx(1 + i / 1000)
        assert recording[i].depth[0, 0] == 0
