"""Start and high rate on mixed networks are run as far as asked for, and told by network."""

from __future__ import annotations

import pytest
from paper import mixed
from paper.step import Outcome, Scale

QUICK, DEFAULT, FULL = Scale(quick=True), Scale(), Scale(full=True)


def test_a_full_run_sends_as_many_on_mixed_networks_as_the_paper() -> None:
    """100,000 a pair at 100 Hz take 1000 s and more."""
    [step] = [step for step in mixed.steps(FULL) if step.name == "mixed"]
    assert step.expected_s > 1000


@pytest.mark.parametrize("scale", [QUICK, DEFAULT, FULL])
def test_steps_have_names_of_their_own(scale: Scale) -> None:
    """The journal tells them apart by these."""
    names = [step.name for step in mixed.steps(scale)]
    assert len(set(names)) == len(names)


def test_nothing_that_succeeded_is_an_empty_report() -> None:
    """A failed step has no values."""
    report = mixed.report(DEFAULT, {"pairs-5": Outcome(failure="no robot came online")})
    assert (list(report.sections), list(report.comparisons)) == ([], [])


def test_starts_are_told_by_network() -> None:
    """With those who got nothing, and the paper's 100 % beside."""
    values = {"message_s": {"fixed": [1.5, 2.5], "4G": [3.0, None]}, "failures": {}}
    report = mixed.report(DEFAULT, {"start-mixed-1": Outcome(values=values)})
    table = report.sections[0].table
    assert "| fixed | 2 of 2 | 2.00 |" in table[2]
    assert "| 4G | 1 of 2 | 3.00 |" in table[3]
    [row] = report.comparisons
    assert (row.ours, row.falls_short) == (75, True)
    assert len(report.data[0].rows) == 4
    assert any("1 robots of 4" in one for one in report.shortfalls)
