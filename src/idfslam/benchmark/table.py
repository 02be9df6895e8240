"""Tables of measured values: columns, means with their spread, Markdown."""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """A measured value of a run: its name in the JSON, and its column in the table."""

    key: str
    title: str
    unit: float = 1.0  # factor from the stored value to the table's
    digits: int = 2


SURFACE = (
    Column("accuracy_m", "accuracy [cm]", 100),
    Column("completion_m", "completion [cm]", 100),
    Column("completion_ratio", "ratio < 5 cm [%]", 100, 1),
    Column("precision", "precision at 1 cm [%]", 100, 1),
    Column("f1", "F1 at 1 cm [%]", 100, 1),
    Column("normal_angle", "normals off [deg]"),
)
"""What is measured of a mesh."""


@dataclass(frozen=True)
class MeanStd:
    """Mean and sample standard deviation of `count` values; a single value has no deviation."""

    mean: float
    deviation: float | None
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> "MeanStd":
        """Of at least one value. Raises statistics.StatisticsError for none."""
        return cls(statistics.fmean(values), statistics.stdev(values) if len(values) > 1 else None, len(values))

    def text(self, unit: float = 1.0, digits: int = 2) -> str:
        """`mean ± deviation`."""
        mean = f"{self.mean * unit:.{digits}f}"
        return mean if self.deviation is None else f"{mean} ± {self.deviation * unit:.{digits}f}"


def markdown_table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; the first column is aligned left, the others right."""
    lines = [titles, ["---", *["---:"] * (len(titles) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
