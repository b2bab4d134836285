"""Experiment 4, the spiral: robots are driven along it without looking; where they end shows how well they were led.

The paper's five pairs end within 0.001 m in x and 0.004 m in y. Used by `python -m paper`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from paper.spiral_plan import NETWORKS, Drive, Plan, plan_of
from paper.spiral_report import report
from paper.spiral_run import drive
from paper.step import Part, Report, Results, Scale, Step

# What starting a robot, and everything else but the drive, takes.
ROBOT_S, OTHER_S = 1.2, 10.0


def steps(scale: Scale) -> Sequence[Step]:
    """One for all that are driven at the same time."""
    plan = plan_of(scale)
    return [_step(plan, each) for each in plan.drives]


def _step(plan: Plan, each: Drive) -> Step:
    robots = plan.pairs * len(each.networks)
    where = ", ".join(NETWORKS[network].name for network in each.networks)
    return Step(
        name=each.name,
        title=f"{robots} spirals at once, {where}, repetition {each.repetition} of {plan.repetitions}",
        expected_s=plan.duration_s + robots * ROBOT_S + OTHER_S,
        run=partial(drive, plan=plan, what=each),
    )


def _report(scale: Scale, results: Results) -> Report:
    return report(plan_of(scale), results)


PART = Part(name="spiral", title="An open-loop spiral", steps=steps, report=_report)
