"""Runs of numbered messages are reported as they were, also when they went wrong."""

from __future__ import annotations

from numbered_runs import a_run
from paper import numbered_report
from paper.numbered import Histogram
from paper.numbered_report import thinned


def test_what_went_wrong_is_said() -> None:
    """What was lost with the numbers, what was not sent, duplicated or reordered, and why connections ended."""
    run = a_run(
        lost=2,
        missing={"1": [7, 8]},
        unsent=3,
        reordered=4,
        redials=1,
        endings=["close code 4408"],
        failed_dials=6,
        dial_failures=["close code 4505"],
    )
    said = "\n".join(numbered_report.shortfalls({"2 pairs": run}))
    for part in (
        "2 of 100",
        "pair 1: 7, 8",
        "3 messages could not",
        "4 messages were reordered",
        "4408",
        "6 connections failed before the start (close code 4505)",
    ):
        assert part in said
    assert numbered_report.shortfalls({"2 pairs": a_run()}) == []


def test_a_full_machine_is_said() -> None:
    """Its latency is none of the way's; and how much of it was other work."""
    run = a_run(cpu_s={**a_run()["cpu_s"], "machine": 1.96})
    [sentence] = numbered_report.shortfalls({"2 pairs": run})
    assert "98% busy (86% with other work)" in sentence


def test_a_row_has_as_many_cells_as_its_table() -> None:
    """In all tables, also with a run on several networks."""
    parts = {name: a_run(pairs=1) for name in ("fixed", "4G")}
    runs = {"2 pairs": a_run(networks=parts), "none came": a_run(received=0, latency={})}
    for lines in (numbered_report.delivery_table(runs), numbered_report.cost_table(runs)):
        assert len({line.count(" | ") for line in lines}) == 1
    assert len(numbered_report.delivery_table(runs)) == 2 + 4


def test_a_curve_keeps_its_ends_and_few_points() -> None:
    """However many latencies there were."""
    made = Histogram()
    for number in range(20_000):
        made.add(number / 100)
    points = made.exceeded_by()
    kept = thinned(points)
    assert kept[0] == points[0]
    assert kept[-1] == points[-2]
    assert len(kept) < 400
    assert thinned([]) == thinned([(5.0, 0.0)])
