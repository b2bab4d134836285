"""The figure of the comparison: round trips of every way, idle and behind video."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from paper.step import Plot, quantile

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Round trips in ms by the way and what went on meanwhile.
Conditions = Mapping[str, Mapping[str, Sequence[float]]]
COLOURS = ("#0072b2", "#d55e00", "#e69f00")


def plots(conditions: Conditions) -> list[Plot]:
    """One figure, or none when nothing was measured."""
    if not conditions:
        return []
    caption = (
        "Round trips by way: the bar ends at the median, the line at the 99th percentile; from above: idle, behind the "
        "first video, behind the second."
    )
    return [
        Plot(
            name="peers-round-trips",
            caption=caption,
            draw=lambda drawing: draw(drawing, conditions),
        )
    ]


def draw(drawing: Figure, conditions: Conditions) -> None:
    """Bars beside each other, on a logarithmic axis."""
    axes = drawing.add_subplot()
    places, names, place = [], [], 0.0
    for way, measured in conditions.items():
        for number, (meanwhile, trips) in enumerate(measured.items()):
            p50, p99 = quantile(trips, 0.5), quantile(trips, 0.99)
            axes.barh(place, p50, color=COLOURS[number % len(COLOURS)], height=0.8)
            axes.plot([p50, p99], [place, place], color="black", linewidth=1.5)
            places.append(place)
            names.append(f"{way}, {meanwhile}")
            place += 1
        place += 0.6
    axes.set_yticks(places, names, fontsize=8)
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlabel("round trip, ms")
    drawing.set_size_inches(8.0, 1.2 + 0.3 * len(places))
