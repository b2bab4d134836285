"""The steps of starts and returns, and what the page says of their outcomes."""

from __future__ import annotations

import re

import pytest
from fleet_runs import run
from matplotlib.figure import Figure
from paper.startup import PART
from paper.step import Outcome, Scale, Step

QUICK, DEFAULT, FULL = Scale(quick=True), Scale(), Scale(full=True)


def steps(scale: Scale) -> list[Step]:
    return list(PART.steps(scale))


def report(results):
    return PART.report(QUICK, results)


def results(**others: Outcome) -> dict[str, Outcome]:
    """All steps of the quick scale; those that are named are others."""
    named = {name.replace("_", "-"): outcome for name, outcome in others.items()}
    return {step.name: run(*[1.5] * 10) for step in steps(QUICK)} | named


@pytest.mark.parametrize(("scale", "repetitions"), [(DEFAULT, 20), (FULL, 1000)])
def test_the_papers_repetitions_and_beyond(scale, repetitions):
    """50 robots as often as the scale says, larger fleets once, and both kinds of restarts."""
    names = [step.name for step in steps(scale)]
    assert sum(name.startswith("start-50-") for name in names) == repetitions
    assert {"whole-50", "start-200-1", "start-500-1", "start-1000-1"} <= set(names)
    assert {"reconnect-50-tunnels", "reconnect-200-server"} <= set(names)
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[a-z0-9-]+", name) for name in names)


def test_the_quick_scale_is_short():
    """Continuous integration has 25 s for it."""
    assert sum(step.expected_s for step in steps(QUICK)) <= 50
    assert {"start-10-1", "start-10-2"} < {step.name for step in steps(QUICK)}


def test_all_went_well():
    """Full success against the paper, no shortfall, a figure of starts and one of returns, and all rows as data."""
    told = report(results())
    assert [row.falls_short for row in told.comparisons] == [False] * len(told.comparisons)
    assert told.comparisons[0].against == "paper"
    assert "10 at once, 2 times" in told.comparisons[0].what
    assert not list(told.shortfalls)
    assert [plot.name for plot in told.plots] == ["startup-times", "startup-returns"]
    assert [len(data.rows) for data in told.data] == [20, 10 * (len(steps(QUICK)) - 2)]
    assert "| 10 | 2 of 2 | 20 of 20 | 0 | 0 | 1.50 | 1.50 | 1.50 |" in "\n".join(
        told.sections[0].table
    )


def test_what_failed_is_printed_as_such():
    """A robot without a message, one that came late, a step that fell over, a message at the wrong robot, a limit."""
    bad = run(
        *[1.5] * 8,
        70.0,
        None,
        wrong=1,
        limits=["sshd met its limit"],
        waits={"closed with 4503": 3},
        failures=["no answer"],
    )
    told = report(results(start_10_1=bad, start_10_2=Outcome(failure="a worker ended")))
    paper, *_, wrong = told.comparisons
    assert (paper.ours, paper.falls_short) == (40.0, True)
    assert (wrong.ours, wrong.falls_short) == (1, True)
    words = "\n".join(told.shortfalls)
    assert "start-10-2: a worker ended" in words
    assert "12 of 20 had no message within 60 s, 1 of them later (2 of 2 runs)" in words
    assert "operators heard: closed with 4503 (3); an agent said last: no answer" in words
    assert "sshd met its limit" in words


@pytest.mark.parametrize("scale", [QUICK, DEFAULT])
def test_a_page_before_anything_has_run(scale):
    """Tables with nothing in them, and no figure."""
    told = PART.report(scale, {})
    assert not told.comparisons
    assert not told.plots
    assert all(len({row.count("|") for row in section.table}) == 1 for section in told.sections)


def test_tables_are_whole():
    """Each row has as many cells as the head."""
    for section in report(results()).sections:
        assert len({row.count("|") for row in section.table}) == 1, section.title


def test_figures_can_be_drawn():
    """A fleet of which some never came has a curve that ends below the top."""
    told = report(results(start_10_2=run(*[2.0] * 9, None)))
    for plot in told.plots:
        drawing = Figure()
        plot.draw(drawing)
        assert drawing.axes[0].get_lines()
