"""The figures of starts and returns: which share of the fleet had its message, and when. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from paper.fleet_groups import FAILED_AFTER_S, Group
from paper.reconnect import IN_WORDS
from paper.step import Plot

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

STARTS = (
    "Share of the robots that had their first message, by the time since all were told to start, over all "
    "repetitions. A curve that does not reach 100 % belongs to a fleet of which some robots never got it; the dotted "
    "line is where one counts as failed."
)
RETURNS = (
    "Share of the robots that had a message again, by the time since the server's containers were killed. The dotted "
    "line is where a robot counts as failed."
)


def plots(starts: Sequence[Group], returns: Sequence[Group]) -> list[Plot]:
    """One figure each, of what has been measured."""
    wanted = (("startup-times", STARTS, starts), ("startup-returns", RETURNS, returns))
    return [
        Plot(name=name, caption=caption, draw=partial(draw, found=some))
        for name, caption, found in wanted
        if (some := [group for group in found if group.message_s])
    ]


def draw(drawing: Drawing, *, found: Sequence[Group]) -> None:
    """A curve for each group."""
    axes = drawing.subplots()
    for group in found:
        times = sorted(group.message_s)
        shares = [100.0 * number / group.wanted for number in range(1, len(times) + 1)]
        axes.step([times[0], *times], [0.0, *shares], where="post", label=label(group))
    axes.axvline(FAILED_AFTER_S, color="grey", linestyle=":")
    axes.set_xscale("log")
    axes.set_xlabel("seconds")
    axes.set_ylabel("robots with a message, %")
    axes.set_ylim(0, 102)
    axes.legend(loc="lower right")


def label(group: Group) -> str:
    """What the curve is of."""
    if group.kind == "reconnect":
        return f"{group.count} robots, {IN_WORDS[group.what]}"
    whole = "whole " if group.kind == "whole" else ""
    return f"{group.count} {whole}robots at once, {len(group.runs)} run(s)"
