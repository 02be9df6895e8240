"""A few mutations of each fuzz target, which hypothesis chooses; `make fuzz` runs many."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzz.campaign import ACCEPTED, REFUSED, Campaign, quiet
from fuzz.targets import TARGETS

FEW, MORE = 6, 200  # mutations of each target


@pytest.mark.parametrize("count", [FEW, pytest.param(MORE, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", TARGETS)
def test_damaged_files_end_in_one_line(name: str, count: int, tmp_path: Path) -> None:
    campaign = Campaign(TARGETS[name], tmp_path / "files")

    @settings(max_examples=count)
    @given(number=st.integers(0, 2**31))
    def ends_in_one_line(number: int) -> None:
        outcome, message = campaign.judge(number)
        assert outcome in (ACCEPTED, REFUSED), message

    with quiet():
        ends_in_one_line()
