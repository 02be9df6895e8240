"""A share of the time, with a clock that tests turn."""

from idfslam.viewer.time_budget import Budget


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_the_first_piece_is_free_and_the_next_waits_until_both_fit() -> None:
    clock = Clock()
    budget = Budget(0.1, clock)
    assert budget.allows()
    with budget.spending():
        clock.now += 2.0
    assert budget.spent == 2.0
    clock.now = 39.0  # 3.9 s of it are for this work, and the next piece would make it 4
    assert not budget.allows()
    clock.now = 40.0
    assert budget.allows()


def test_the_share_is_kept_while_pieces_grow() -> None:
    clock = Clock()
    budget, cost, done = Budget(0.05, clock), 0.1, 0
    while clock.now < 100:
        if budget.allows():
            with budget.spending():
                clock.now += cost
            cost, done = cost * 1.1, done + 1
        clock.now += 0.1
    assert done > 10
    assert budget.spent <= 0.05 * clock.now + 0.1 * cost  # but for what the last piece cost more than the one before


def test_work_that_fails_has_cost_too() -> None:
    clock = Clock()
    budget = Budget(0.5, clock)
    try:
        with budget.spending():
            clock.now += 3.0
            raise ValueError
    except ValueError:
        pass
    assert budget.spent == 3.0
