"""Experiment 4, the spiral: robots are driven along it without looking; where they end tells how well they were led.

The paper's five pairs end within 0.001 m in x and 0.004 m in y. Used by `python -m paper`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from paper.spiral_plan import NETWORKS, plan_of
from paper.spiral_report import report
from paper.spiral_run import repetition
from paper.step import Part, Report, Results, Scale, Step

# What starting a robot, and everything else but the drive, takes.
ROBOT_S, OTHER_S = 1.2, 10.0


def steps(scale: Scale) -> Sequence[Step]:
    """One a repetition: every network and every pair at the same time."""
    plan = plan_of(scale)
    robots = plan.pairs * len(NETWORKS)
    return [
        Step(
            name=name,
            title=f"{robots} spirals at once over {len(NETWORKS)} networks, repetition {number} of {plan.repetitions}",
            expected_s=plan.duration_s + robots * ROBOT_S + OTHER_S,
            run=partial(repetition, plan=plan),
        )
        for number, name in enumerate(plan.names, 1)
    ]


def _report(scale: Scale, results: Results) -> Report:
    return report(plan_of(scale), results)


PART = Part(name="spiral", title="An open-loop spiral", steps=steps, report=_report)
