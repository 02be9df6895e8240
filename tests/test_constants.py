"""Every constant of the algorithms says what it is: there is one page of all of them, generated from the code."""

import re
from pathlib import Path
from types import ModuleType

import pytest

from helpers.docs_module import docs_module

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def documented() -> ModuleType:
    return docs_module("constants")


def test_each_constant_has_a_comment(documented: ModuleType) -> None:
    found = list(documented.constants(ROOT / "src/idfslam"))
    assert len(found) > 100
    assert [f"{c.module}: {c.name}" for c in found if len(c.comment) < 15] == []


def test_each_constant_says_what_raising_it_does(documented: ModuleType) -> None:
    """Or that there is nothing to raise: a fact of a format, a version."""
    effect = re.compile(
        r"\b(raised|lowered|widened|wider|narrowed|larger|smaller|more|less|fewer|longer|shorter|likewise|a fact|counts up|counted up)\b",
        re.IGNORECASE,
    )
    assert [f"{c.module}: {c.name}" for c in documented.constants(ROOT / "src/idfslam") if not effect.search(c.comment)] == []


def test_the_page_shows_value_and_comment(documented: ModuleType) -> None:
    rows = documented.page(ROOT / "src/idfslam").splitlines()
    assert any(row.startswith("| `_CHI_SQUARE` | `16.81` | 99 % bound of the chi-square distribution") for row in rows)
    assert "## slam/place_recognition/relocalisation_check.py" in rows
    assert "## datasets/cameras/plausibility.py" in rows


def test_what_counts_as_a_constant(documented: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "slam").mkdir()
    (tmp_path / "slam" / "part.py").write_text(
        "import math\n_A = 2.0  # [m] first\n#    and more\n_B, _C = 1, math.radians(3)  # two\n_NAME = 'text'\nlower = 3\n_NONE = 4\n"
        "# above\n# it\n_D = 5\n"
    )
    found = [(c.name, c.value, c.comment) for c in documented.constants(tmp_path)]
    assert found == [
        ("_A", "2.0", "[m] first and more"),
        ("_B, _C", "(1, math.radians(3))", "two"),
        ("_NONE", "4", ""),
        ("_D", "5", "above it"),
    ]
