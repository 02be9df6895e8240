"""`idf-slam view --web` in a browser that has no screen: it opens on the scene, the image and the plots."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from helpers.known_slam import KnownSlam
from helpers.rerun_viewer import NO_RERUN, viewer
from idfslam.config import FAST
from idfslam.datasets import open_recording
from idfslam.runs.runner import run

pytestmark = pytest.mark.slow

_SOFTWARE = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]  # WebGL without a GPU
_PATIENCE = 180  # [s] until all is drawn: without a GPU a picture takes a second or more
WIDTH, HEIGHT = 1000, 700


def free_port() -> int:
    """A port with the next one free too, most likely."""
    with socket.socket() as trial:
        trial.bind(("", 0))
        return int(trial.getsockname()[1])


def share(picture: NDArray[np.int64], colour: tuple[int, int, int], tolerance: int) -> float:
    """Of the pixels that are like `colour`."""
    return float((np.abs(picture - colour).max(-1) <= tolerance).mean())


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is sent as POSIX does")
def test_a_browser_shows_the_scene(box_recording: Path, tmp_path: Path) -> None:
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium is installed: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright drives the browser: pip install playwright")
    pytest.importorskip("rerun", reason=NO_RERUN)
    recording = open_recording(box_recording)
    run(recording, FAST, tmp_path, make_slam=KnownSlam, viewer=viewer())  # type: ignore[arg-type]
    command = [sys.executable, "-m", "idfslam.cli", "view", str(tmp_path), "--web", "--port", str(free_port())]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ) as server, playwright.sync_playwright() as driver:
        try:
            assert server.stdout is not None
            address = server.stdout.readline().split()[0]
            window = driver.chromium.launch(executable_path=browser, headless=True, args=_SOFTWARE)
            page = window.new_page(viewport={"width": WIDTH, "height": HEIGHT})
            page.goto(address, wait_until="commit", timeout=_PATIENCE * 1000)
            mean = tuple(int(value) for value in recording[len(recording) - 1].colour.reshape(-1, 3).mean(0) * 255)
            deadline = time.monotonic() + _PATIENCE
            while True:
                picture = np.array(Image.open(BytesIO(page.screenshot(timeout=_PATIENCE * 1000))).convert("RGB")).astype(np.int64)
                scene, images = picture[60:480, : WIDTH * 7 // 10], picture[60:480, WIDTH * 8 // 10 :]
                red, dark = share(scene, (220, 30, 30), 60), share(scene, (16, 18, 22), 12)
                coloured = share(images, mean, 90)
                if (red > 0.01 and dark > 0.3 and coloured > 0.2) or time.monotonic() > deadline:
                    break
                time.sleep(2)
            assert red > 0.01, "the red mesh is in the scene"
            assert dark > 0.3, "the scene is large, and dark around the mesh"
            assert coloured > 0.2, "the camera's image stands beside it"
            window.close()
        finally:
            server.send_signal(signal.SIGINT)
        assert server.wait(30) in (0, -signal.SIGINT, 128 + signal.SIGINT)  # Ctrl-C ends it
