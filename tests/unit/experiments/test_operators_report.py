"""What the page says of the three operators, also when steps failed, are missing, or ours is worse."""

from __future__ import annotations

from typing import Any

from paper.operators_plan import ADAPTIVE, NETWORKS, OURS, PLAIN, step_name
from paper.operators_report import HEADER, measured_runs, report
from paper.operators_values import Run
from paper.step import Outcome, Scale
from seen_robot import seen

SCALE = Scale()


def outcome(busy: float = 0.4, **ways: Any) -> Outcome:
    """A step that succeeded, with a robot for each way."""
    runs = {way: Run(lasted_s=1.0, busy=busy, robots=[robot]) for way, robot in ways.items()}
    return Outcome(values={way: run.as_values() for way, run in runs.items()})


def old(age_ms: float) -> Any:
    """A robot whose pictures are so old."""
    return seen(pictures=[(100.0 * number, 20_000, age_ms) for number in range(10)])


def test_nothing_has_run() -> None:
    """No tables, figures or comparisons, and no error."""
    made = report(SCALE, {})
    assert not made.comparisons
    assert not made.plots
    assert not made.data
    assert [section.table for section in made.sections] == [[]]


def test_a_failed_step_has_a_row_that_says_why() -> None:
    """With nothing of it taken for Markdown, and as many cells as the header has."""
    made = report(SCALE, {step_name("4g-7", 80): Outcome(failure="it | fell")})
    row = made.sections[1].table[2]
    assert r"failed: it \| fell" in row
    assert row.replace(r"\|", "").count("|") == HEADER.count("|")
    assert not made.comparisons
    assert "0 of 1 steps" in made.sections[0].text


def test_each_way_has_a_row_as_wide_as_the_header() -> None:
    """The adaptive one tells what quality it came to."""
    results = {
        step_name("4g-7", 90): outcome(ours=seen(), plain=seen(quality=None)),
        step_name("4g-7", ADAPTIVE): outcome(ours=seen(quality=61.7)),
    }
    table = report(SCALE, results).sections[1].table
    assert len(table) == 5
    assert {row.count("|") for row in table} == {HEADER.count("|")}
    assert "adaptive: 62" in table[-1]


def test_ours_is_compared_at_the_highest_quality() -> None:
    """Per network, and only with what was measured beside it."""
    results = {
        step_name("4g-7", 90): outcome(ours=old(40.0), plain=old(400.0)),
        step_name("4g-7", 50): outcome(ours=old(40.0), plain=old(50.0)),
        step_name("4g-5", 90): outcome(ours=old(40.0)),
    }
    made = report(SCALE, results).comparisons
    ages = [one for one in made if "age" in one.what]
    assert [(one.reference, one.ours, one.falls_short) for one in ages] == [(400, 40, False)]


def test_every_command_has_to_come() -> None:
    """Of ours, in all runs together."""
    results = {step_name("4g-7", 50): outcome(ours=seen(commands_ms=[1.0, None, 1.0]))}
    [one] = report(SCALE, results).comparisons
    assert (one.reference, one.ours, one.better, one.falls_short) == (3, 2, "equal", True)


def test_where_plain_is_better_is_said() -> None:
    """How often, and the worst of them."""
    results = {
        step_name("4g-7", 90): outcome(ours=old(40.0), plain=old(400.0)),
        step_name("4g-7", 80): outcome(ours=old(44.0), plain=old(40.0)),
        step_name("4g-7", 50): outcome(ours=old(80.0), plain=old(40.0)),
    }
    [line] = [
        line
        for line in report(SCALE, results).shortfalls
        if line.startswith("Age of pictures, p95")
    ]
    assert "in 2 of 3 runs, at the most 80.0 beside 40.0 ms" in line
    assert "quality 50" in line


def test_a_camera_that_the_machine_holds_up_is_said() -> None:
    """It is no fault of the network."""
    results = {step_name("4g-7", 90): outcome(ours=seen(camera_fps=11.0))}
    assert any("11.0" in line and "machine" in line for line in report(SCALE, results).shortfalls)
    results = {step_name("4g-7", 90): outcome(ours=seen(camera_fps=15.0))}
    assert not report(SCALE, results).shortfalls


def test_a_machine_that_has_nothing_left_is_said() -> None:
    """In how many runs."""
    results = {step_name("4g-7", 90): outcome(busy=0.97, ours=seen(camera_fps=15.0))}
    [line] = report(SCALE, results).shortfalls
    assert "over 95% busy in 1 of 1 runs" in line


def test_no_picture_of_ours_is_said() -> None:
    """It is worse than any figure."""
    results = {step_name("4g-7", 90): outcome(ours=seen(pictures=[]), plain=seen())}
    assert any(line.startswith("No age of pictures") for line in report(SCALE, results).shortfalls)


def test_a_row_a_robot_and_run_goes_to_the_file() -> None:
    """As wide as its header."""
    results = {step_name("4g-7", 90): outcome(ours=seen(), plain=seen())}
    [data] = report(SCALE, results).data
    assert len(data.rows) == 2
    assert {len(row) for row in data.rows} == {len(data.header)}


def test_runs_are_in_the_plans_order() -> None:
    """Whatever the order in which they were kept."""
    results = {
        step_name(network, quality): outcome(plain=seen(), ours=seen())
        for quality in (50, 90)
        for network in reversed(NETWORKS)
    }
    first = next(iter(NETWORKS))
    assert list(measured_runs(results))[:4] == [
        (first, 90, OURS),
        (first, 90, PLAIN),
        (first, 50, OURS),
        (first, 50, PLAIN),
    ]
