"""What the operators' experiment runs, and in which order."""

from __future__ import annotations

import re

from paper.operators import PART
from paper.operators_plan import NETWORKS, OURS, PLAIN, QUALITIES
from paper.profiles import TABLE_2
from paper.step import Scale, Step


def ways(step: Step) -> list[str]:
    """Those that a step measures, in its order."""
    return list(step.run.keywords["ways"])  # type: ignore[attr-defined]


def test_all_networks_and_qualities_are_measured_both_ways() -> None:
    """And each network once with the default range, which is ours alone."""
    steps = PART.steps(Scale())
    assert len(steps) == len(TABLE_2) * (len(QUALITIES) + 1)
    both = [step for step in steps if sorted(ways(step)) == [OURS, PLAIN]]
    assert len(both) == len(NETWORKS) * len(QUALITIES)
    assert all(ways(step) == [OURS] for step in steps if step.name.endswith("adaptive"))


def test_which_way_is_first_takes_turns() -> None:
    """So that neither has what the other leaves behind more often than it must."""
    first = [ways(step)[0] for step in PART.steps(Scale()) if step.name.startswith("fixed-94")]
    assert first == [OURS, PLAIN, OURS, PLAIN, OURS, OURS]


def test_steps_have_names_that_the_journal_takes() -> None:
    """Each its own."""
    for scale in (Scale(), Scale(quick=True)):
        names = [step.name for step in PART.steps(scale)]
        assert len(set(names)) == len(names)
        assert all(re.fullmatch(r"[a-z0-9-]+", name) for name in names)


def test_a_quick_run_is_short() -> None:
    """It has 35 s in all."""
    assert sum(step.expected_s for step in PART.steps(Scale(quick=True))) <= 35
