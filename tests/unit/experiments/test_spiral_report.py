"""The page's part tells all that was driven, planned and lost, and holds it against the paper."""

from __future__ import annotations

import io
import json
from typing import Any

import pytest
from matplotlib.figure import Figure
from paper.spiral import PART
from paper.spiral_course import punctual, stepped_ends, way_of
from paper.spiral_files import files
from paper.spiral_plan import NETWORKS, Drive, plan_of
from paper.spiral_report import report
from paper.step import Outcome, Report, Scale

WHOLE, QUICK = Scale(), Scale(quick=True)
PLAN = plan_of(WHOLE)
IDEAL_WAY = list(way_of(punctual(PLAN.wanted), points=10))
ENDS = stepped_ends(PLAN.wanted, phases=PLAN.pairs)
LIMIT_BYTES = 300_000


def pair(network: str, number: int, failure: str = "") -> dict[str, Any]:
    times = [change.at_s * 1000 for change in punctual(PLAN.wanted)]
    end = ENDS[number - 1]
    return {
        "network": network,
        "pair": number,
        "failure": failure,
        "sent_ms": times,
        "arrived_ms": [at + 20 for at in times][: 3 if failure else None],
        "end": None if failure else [end.x, end.y, end.theta],
        "steps": 1937,
        "travelled_m": 78.2,
        "way": [] if failure else IDEAL_WAY,
    }


def drive(what: Drive, lost: str = "") -> Outcome:
    pairs = [
        pair(network, number, "the robot got 3 of 63 commands" if network == lost else "")
        for network in what.networks
        for number in range(1, PLAN.pairs + 1)
    ]
    return Outcome(values=json.loads(json.dumps({"repetition": what.repetition, "pairs": pairs})))


def driven(repetitions: int, lost: str = "") -> dict[str, Outcome]:
    return {what.name: drive(what, lost) for what in PLAN.drives if what.repetition <= repetitions}


def text_of(made: Report) -> str:
    return "\n".join(section.markdown for section in made.sections)


def test_all_runs_of_all_repetitions_are_told() -> None:
    """Both networks that the paper has stand beside its sigmas."""
    made = report(PLAN, driven(10))
    assert text_of(made).count("50 of 50") == len(NETWORKS) + 1
    rows = {(row.what, row.against): row for row in made.comparisons}
    assert len(rows) == len(NETWORKS) + 4
    sigma = next(row for row in made.comparisons if "final x" in row.what)
    assert sigma.reference == 0.001
    assert sigma.falls_short == (sigma.ours > 0.001)
    assert [row.ours for row in made.comparisons if row.better == "equal"] == [100.0] * 3
    assert any("steps alone" in sentence for sentence in made.shortfalls)


def test_lost_runs_and_repetitions_are_counted_and_named() -> None:
    """A network on which nobody got to the end has a row without figures."""
    failed = {"repetition-02-fixed": Outcome(failure="no stack")}
    made = report(PLAN, {**driven(1, lost="4g"), **failed})
    assert f"| {NETWORKS['4g'].name} | 0 of 50 | - |" in text_of(made)
    assert f"| {NETWORKS['fixed'].name} | 5 of 50 | " in text_of(made)
    assert [each[:17] for each in made.shortfalls if "not driven" in each] == ["5 of 5 spirals on"]
    assert [row.ours for row in made.comparisons if row.better == "equal"] == [10.0, 0.0, 10.0]


def test_nothing_has_run() -> None:
    """There is a page all the same, which compares nothing."""
    made = report(PLAN, {})
    assert (made.comparisons, made.plots, made.data) == ([], [], [])
    assert text_of(made).count("| 0 of 50") == len(NETWORKS)


def test_a_quick_run_says_that_it_is_shortened_and_compares_no_ends() -> None:
    """Its ends are not the paper's."""
    plan = plan_of(QUICK)
    commands = len(plan.wanted) + 1
    pairs = [
        {**one, "sent_ms": one["sent_ms"][:commands], "arrived_ms": one["arrived_ms"][:commands]}
        for one in (pair(network, 1) for network in NETWORKS)
    ]
    made = report(plan, {"repetition-01": Outcome(values={"repetition": 1, "pairs": pairs})})
    assert "only the first 20 s" in text_of(made)
    assert {row.unit for row in made.comparisons} == {"%"}
    assert made.shortfalls == []


def test_each_network_has_a_figure() -> None:
    """It can be drawn, also where some runs failed."""
    made = report(PLAN, driven(1, lost="4g"))
    assert [plot.name for plot in made.plots] == ["spiral-fixed", "spiral-4g-jitter"]
    drawing = Figure()
    made.plots[0].draw(drawing)
    drawn = io.BytesIO()
    drawing.savefig(drawn, format="svg")
    assert len(drawing.axes) == 2
    assert 10_000 < len(drawn.getvalue()) < 500_000


def test_files_of_the_whole_experiment_stay_small() -> None:
    """With all 150 runs each is under 300 KB, and each row has a value a column."""
    for data in report(PLAN, driven(10)).data:
        written = "\n".join(",".join(map(str, row)) for row in [data.header, *data.rows])
        assert len(written) < LIMIT_BYTES, data.name
        assert {len(row) for row in data.rows} == {len(data.header)}, data.name


def test_what_failed_is_in_the_files() -> None:
    """With its reason, and empty where nobody saw anything."""
    runs = report(PLAN, driven(1, lost="4g"))
    [ends] = [data for data in runs.data if data.name == "spiral-ends"]
    [lost, *_] = [dict(zip(ends.header, row, strict=True)) for row in ends.rows if row[3]]
    assert lost["failure"] == "the robot got 3 of 63 commands"
    assert (lost["network"], lost["x_m"], lost["x_arrivals_m"]) == ("4g", "", "")
    assert files(PLAN, []) == []


@pytest.mark.parametrize(("scale", "steps"), [(WHOLE, 30), (QUICK, 1)])
def test_a_step_is_what_is_driven_at_once(scale: Scale, steps: int) -> None:
    """Names are unique, and the report knows them."""
    made = PART.steps(scale)
    assert len({step.name for step in made}) == len(made) == steps
    assert [step.name for step in made] == [drive.name for drive in plan_of(scale).drives]
    assert PART.report(scale, {}).comparisons == []
