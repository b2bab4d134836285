"""The high rate runs what the paper and the issue ask for, and is compared with the paper."""

from __future__ import annotations

import pytest
from numbered_runs import a_run
from paper import high_rate
from paper.high_rate import LADDER, PAPERS_RUN, cases
from paper.step import Outcome, Scale

QUICK, DEFAULT, FULL = Scale(quick=True), Scale(), Scale(full=True)


def test_the_default_is_the_papers_run_and_what_the_issue_asks_for_beyond() -> None:
    """Pairs, messages and rates; a run has its name once."""
    runs = {one.name: one for case in cases(DEFAULT) for one in case.runs}
    planned = {name: (one.pairs, one.plan.count, one.plan.rate_hz) for name, one in runs.items()}
    assert planned[PAPERS_RUN] == (5, 100_000, 100)
    assert planned["pairs-20"] == (20, 10_000, 100)
    assert planned["pairs-50"] == (50, 10_000, 100)
    assert planned["rate-1000"] == (1, 100_000, 1000)
    assert {f"line-{mbit_s}" for mbit_s in LADDER} < planned.keys()
    assert len(runs) == sum(len(case.runs) for case in cases(DEFAULT))


@pytest.mark.parametrize("scale", [QUICK, DEFAULT, FULL])
def test_steps_have_names_of_their_own(scale: Scale) -> None:
    """The journal tells them apart by these."""
    names = [step.name for step in high_rate.PART.steps(scale)]
    assert len(set(names)) == len(names)


def test_the_papers_run_is_compared() -> None:
    """Met when every message arrived; it falls short when one was lost, or not even sent."""
    for changes, falls_short in (({}, False), ({"lost": 1}, True), ({"unsent": 1}, True)):
        report = high_rate.report(
            DEFAULT, {PAPERS_RUN: Outcome(values={"runs": {PAPERS_RUN: a_run(**changes)}})}
        )
        [row] = report.comparisons
        assert row.falls_short is falls_short
        assert "100 " in row.what


def test_nothing_that_succeeded_is_an_empty_report() -> None:
    """A failed step has no values."""
    report = high_rate.report(DEFAULT, {"pairs-5": Outcome(failure="no robot came online")})
    assert (list(report.sections), list(report.comparisons)) == ([], [])


def test_the_slow_lines_table_tells_what_was_offered() -> None:
    """In Mbit/s, of all bytes that crossed the line, over the time that was planned."""
    line = {
        "mbit_s": 1,
        "to_server_bytes": 125_000,
        "from_server_bytes": 62_500,
        "to_server_dropped": 3,
        "from_server_dropped": 0,
    }
    row = high_rate.line_table({"2 pairs": a_run(line=line)})[-1]
    assert row.startswith("| 2 pairs | 1 | 2.00 | 1.00 | 3 | 0 |")
