"""Draws Matplotlib figures as SVG for a light or dark page: the ink takes the text colour of the page."""

import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

INK, GRID = "#1d2733", "#d9dee4"  # colours in PNG files; the page replaces them by currentColor and --grid
ESTIMATE, KEYFRAME, LOST, DOUBTFUL, DEGENERATE = "#d1495b", "#e0a030", "#8b3fc4", "#c2703d", "#3f8fd2"
SERIES = ("#3f8fd2", "#d1495b", "#2f9e6e", "#e0a030", "#8b3fc4", "#5f6b7a", "#c2703d", "#00959e")
WIDTH = 5.8  # [inch] of a chart; larger: smaller letters on a phone
_STYLE: Any = {
    "font.size": 10.5, "axes.titlesize": 10.5, "axes.labelsize": 10, "xtick.labelsize": 9.5, "ytick.labelsize": 9.5, "legend.fontsize": 9.5,
    "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": INK, "xtick.color": INK, "ytick.color": INK, "grid.color": GRID,
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "axes.axisbelow": True, "axes.linewidth": 0.8,
    "grid.linewidth": 0.7, "legend.frameon": False, "svg.fonttype": "none", "svg.hashsalt": "idf-slam",
    "figure.facecolor": "none", "axes.facecolor": "none",
}  # fmt: skip


@dataclass(frozen=True)
class Chart:
    """A figure as SVG and PNG."""

    svg: str
    png: bytes  # on white


def chart(name: str, height: float, draw: Callable[[Figure], None], *, width: float = WIDTH) -> Chart:
    """Draws a figure of this size [inch]. `name` makes the ids of its SVG elements unique on the page."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        canvas = FigureCanvasAgg(figure)
        draw(figure)
        text, data = io.StringIO(), io.BytesIO()
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
        figure.set_layout_engine("none")  # keep the layout of the first drawing: computing it takes as long as drawing
        figure.set_dpi(140)
        figure.set_facecolor("white")
        canvas.print_png(data)  # `savefig` would draw it once more before, for a layout
    return Chart(_for_page(text.getvalue(), name), data.getvalue())


def _for_page(svg: str, name: str) -> str:
    """The <svg> element alone, in the size, font and colours of the page, without references to other addresses."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\s(width|height)="[\d.]+pt"', "", svg, count=2)
    svg = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", svg).replace("xlink:href", "href")
    svg = re.sub(r"(font(?:-family)?:[^;\"]*?)'[^\";]*", r"\1inherit", svg)
    svg = re.sub(r"font: ([\d.]+px) [^;\"]*", r"font-size: \1; font-family: inherit", svg)
    svg = svg.replace(INK, "currentColor").replace(GRID, "var(--grid)")
    used = set(re.findall(r'(?:url\(#|href="#)([\w-]+)', svg))
    return (
        re.sub(r'\sid="([^"]+)"', lambda m: f' id="{name}-{m[1]}"' if m[1] in used else "", svg)
        .replace("url(#", f"url(#{name}-")
        .replace('href="#', f'href="#{name}-')
    )


def key(axes: Axes, columns: int = 4) -> None:
    """Adds a legend above the plot, where it hides nothing."""
    axes.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=columns, handlelength=1.4, columnspacing=1.2, borderaxespad=0.2)
