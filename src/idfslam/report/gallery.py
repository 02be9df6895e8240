"""The pictures and charts of a report: each is a figure of the page and a file in pictures/."""

import io
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray
from PIL import Image

from idfslam.pictures.web_picture import data_address
from idfslam.report.chart import Chart
from idfslam.runs import result_folder
from idfslam.storage.ledger import Ledger

QUALITY = 82  # of the pictures on a page (WebP, 0 to 100); larger: a larger page


@dataclass
class Figure:
    """A picture or chart on the page, with its caption."""

    content: Markup
    caption: str


@dataclass
class Gallery:
    """Collects the figures of the page and writes them as files, too."""

    ledger: Ledger
    written: list[Path] = field(default_factory=list)

    def chart(self, name: str, caption: str, chart: Chart | None) -> list[Figure]:
        """A figure of the chart; empty for None."""
        if chart is None:
            return []
        self._write(name, chart.png)
        return [Figure(Markup(chart.svg), caption)]  # safe: drawn by this program

    def picture(self, name: str, caption: str, image: NDArray[np.uint8]) -> Figure:
        """A figure of an image (H, W, 3) or (H, W, 4)."""
        file = io.BytesIO()
        Image.fromarray(image).save(file, "PNG")
        self._write(name, file.getvalue())
        return Figure(image_element(image, caption), caption)

    def _write(self, name: str, data: bytes) -> None:
        name = f"{result_folder.PICTURES}/{name}.png"
        with self.ledger.replacing(name) as part:
            part.write_bytes(data)
        self.written.append(self.ledger.folder / name)


def image_element(image: NDArray[np.uint8], text: str = "") -> Markup:
    """The element of a page that shows an image (H, W, 3) or (H, W, 4). text: what it shows, for readers who do not see it."""
    element = Markup('<img src="{}" width="{}" height="{}" alt="{}">')
    return element.format(data_address(image, QUALITY), image.shape[1], image.shape[0], text)
