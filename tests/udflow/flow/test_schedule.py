"""The time schedule of section III-B."""

from __future__ import annotations

from itertools import pairwise

import pytest

from udflow.errors import InvalidConfig
from udflow.flow.schedule import TimeSchedule


def test_the_paper_s_five_steps() -> None:
    schedule = TimeSchedule(5)
    assert schedule.times == pytest.approx((1 / 15, 3 / 15, 6 / 15, 10 / 15, 1))
    steps = [schedule.step(k) for k in range(1, 6)]
    assert steps == pytest.approx([1 / 15, 2 / 15, 3 / 15, 4 / 15, 5 / 15])


@pytest.mark.parametrize("steps", [1, 2, 3, 5, 17, 100])
def test_steps_join_the_times_and_sum_to_one(steps: int) -> None:
    schedule = TimeSchedule(steps)
    times = (schedule.time(0), *schedule.times)
    assert times[0] == 0.0
    assert times[-1] == 1.0
    lengths = [schedule.step(k) for k in range(1, steps + 1)]
    assert sum(lengths) == pytest.approx(1.0)
    assert [later - earlier for earlier, later in pairwise(times)] == pytest.approx(lengths)
    assert all(longer > shorter for shorter, longer in pairwise(lengths))


@pytest.mark.parametrize("steps", [0, -1])
def test_fewer_than_one_step_is_refused(steps: int) -> None:
    with pytest.raises(InvalidConfig, match=f"flow.steps is {steps}; choose K >= 1"):
        TimeSchedule(steps)
