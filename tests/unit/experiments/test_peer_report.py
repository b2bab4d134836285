"""The comparison's part of the page tells all ways, also those that failed, and where ours loses."""

from __future__ import annotations

import io
import json
from typing import Any

from matplotlib.figure import Figure
from paper.peer_plan import (
    CHANGES,
    DEFAULT_QUALITY,
    FITTING_QUALITY,
    FRAMES,
    LATENCY,
    LOAD,
    OURS,
    PATIENCE,
    STRAIGHT,
    TITLES,
    Plan,
    name_of,
    plan_of,
)
from paper.peer_report import report
from paper.step import Outcome, Report, Results, Scale

PLAN = Plan()


def video(slower: float) -> dict[str, Any]:
    return {
        "round_trips_ms": [slower * ms for ms in (50.0, 60.0, 90.0)],
        "picture_ages_ms": [slower * ms for ms in (80.0, 90.0)],
        "pictures_per_s": 15.0,
        "picture_bytes": 40_000.0,
    }


def values(key: str, measure: str) -> dict[str, Any]:
    ours = key == OURS
    if measure == LATENCY:
        names = (FRAMES,) if ours else (DEFAULT_QUALITY, FITTING_QUALITY)
        videos = {name: video(5.0 if name == DEFAULT_QUALITY else 1.0) for name in names}
        idle = [41.0, 42.0, 50.0] if ours else [40.0, 41.0, 45.0]
        return {"connect_s": 1.0, "idle_ms": idle, "videos": videos}
    if measure == LOAD:
        cost = {"robot_cpu_s_per_mb": 0.02, "server_cpu_s_per_mb": 0.03}
        return {
            "payload_bit_s": 4.7e6,
            **({**cost} if key != STRAIGHT else dict.fromkeys(cost, 0.0)),
        }
    if measure == PATIENCE:
        return {"patient_s": [105.3]}
    return {"connect_s": [1.0, 2.0], "recover_s": [2.0, 3.0] if ours else [1.0, None]}


def results(plan: Plan = PLAN) -> dict[str, Outcome]:
    return {
        name_of(key, measure): Outcome(values=json.loads(json.dumps(values(key, measure))))
        for key, measure in plan.steps()
    }


def text_of(made: Report) -> str:
    return "\n".join(section.markdown for section in made.sections)


def made_of(known: Results, plan: Plan = PLAN) -> Report:
    return report(plan, known)


def test_every_way_stands_in_every_table() -> None:
    """With each of its videos, and no processor time where there is no program."""
    text = text_of(made_of(results()))
    for title in TITLES.values():
        assert text.count(f"| {title} |") >= 4
    assert f"| {TITLES[STRAIGHT]} | 4.70 | 95% | - | - |" in text
    assert "that took 105 s" in text


def test_never_is_counted_beside_the_times() -> None:
    """A new address after which nothing passed is no number, and none of the others is left out."""
    text = text_of(made_of(results()))
    assert f"| {TITLES['nebula']} | 1.50 | 2.00 | 0 of 2 | 1.00 | 1.00 | 1 of 2 |" in text


def test_a_way_that_failed_is_told_with_its_reason() -> None:
    """In the tables as failed, and among what falls short with why."""
    known = results()
    known[name_of("nebula", LATENCY)] = Outcome(failure="RuntimeError: no nebula here")
    made = made_of(known)
    assert f"| {TITLES['nebula']} | failed |" in text_of(made)
    assert "nebula-latency: RuntimeError: no nebula here" in made.shortfalls


def test_what_has_not_run_is_told() -> None:
    """A page can be written before all of it has run."""
    text = text_of(made_of({name: one for name, one in results().items() if LATENCY in name}))
    assert text.count("| has not run |") == 2 * len(TITLES)


def test_where_ours_loses_is_told() -> None:
    """As a comparison that falls short, or in a sentence where the first table has no row."""
    made = made_of(results())
    short = {(row.what, row.against) for row in made.comparisons if row.falls_short}
    assert ("round trip p50, idle", TITLES["openvpn"]) in short
    assert ("new address, p50", TITLES[STRAIGHT]) in short
    assert not any(what == "round trip p99, behind video" for what, _ in short)
    assert any(line.startswith("round trip p99, idle: 49.8 ms, nebula") for line in made.shortfalls)


def test_there_is_no_comparison_with_what_nobody_measured() -> None:
    """A kernel's time cannot be told, and where ours failed there is nothing to compare."""
    made = made_of(results())
    assert not any(
        "processor" in row.what for row in made.comparisons if row.against == TITLES[STRAIGHT]
    )
    known = {name: one for name, one in results().items() if not name.startswith(OURS)}
    assert made_of(known).comparisons == []


def test_ours_that_never_came_back_falls_short() -> None:
    """Its times alone would hide it."""
    known = results()
    lost = {"connect_s": [1.0, None], "recover_s": [None, None]}
    known[name_of(OURS, CHANGES)] = Outcome(values=lost)
    assert any(line.startswith("3 starts or new addresses") for line in made_of(known).shortfalls)


def test_a_quick_run_tells_what_it_measured() -> None:
    """Round trips and pictures of three ways, and nothing of the rest."""
    plan = plan_of(Scale(quick=True))
    made = made_of(results(plan), plan)
    assert len(made.sections) == 1
    assert "has not run" not in text_of(made)


def test_nothing_measured_is_no_error() -> None:
    """The page can be written before the first step."""
    made = made_of({})
    assert made.plots == []
    assert "has not run" in text_of(made)


def test_figure_and_files_hold_every_value() -> None:
    """The figure can be drawn, and each round trip, picture and change is one row."""
    made = made_of(results())
    drawing = Figure()
    made.plots[0].draw(drawing)
    drawing.savefig(io.BytesIO(), format="svg")
    rows = {data.name: len(data.rows) for data in made.data}
    peers = len(TITLES) - 1
    assert rows["peers-round-trips"] == 3 * (3 * peers + 2)
    assert rows["peers-pictures"] == 2 * (2 * peers + 1)
    assert rows["peers-changes"] == 4 * len(TITLES) + 1
