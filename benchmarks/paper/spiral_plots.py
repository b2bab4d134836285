"""The spirals' figures: all ways drawn one over the other beside the ideal one, and their ends from near. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from sim_robot.kinematics import Pose

from paper import spiral_ends
from paper.spiral_course import end_of, path_of, punctual, stepped_ends
from paper.spiral_ends import Run
from paper.spiral_plan import NETWORKS, Plan
from paper.step import Plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

SIZE_INCH = (10.0, 5.2)
# Where it hides no robot.
BELOW = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.12), "ncols": 2, "fontsize": "small"}
OURS, IDEAL, STEPS, ARRIVALS = "tab:blue", "black", "tab:orange", "tab:green"


def plots(plan: Plan, runs: Sequence[Run]) -> list[Plot]:
    """One for each network on which a robot was seen to drive."""
    found = []
    for network, profile in NETWORKS.items():
        if here := [run for run in spiral_ends.on(network, runs) if run.path]:
            done = len(spiral_ends.completed(here))
            caption = (
                f"Spirals over {profile.name}: the ways of {len(here)} robot(s), {done} of them driven to the end, one "
                "over the other beside the ideal way (left), and where they stood, from the ideal end (right), beside "
                "the ends that turtlesim's steps make of commands at exact intervals, and those of the commands' "
                "arrivals alone."
            )
            found.append(
                Plot(
                    name=f"spiral-{network}",
                    caption=caption,
                    draw=partial(draw, plan=plan, runs=here, title=profile.name),
                )
            )
    return found


def draw(drawing: Drawing, *, plan: Plan, runs: Sequence[Run], title: str) -> None:
    """Draw one network's runs, those that failed included."""
    drawing.set_size_inches(*SIZE_INCH)
    paths, near = drawing.subplots(1, 2)
    drawing.suptitle(title)
    _draw_paths(paths, plan, runs)
    _draw_ends(near, plan, runs)


def _draw_paths(axes: Axes, plan: Plan, runs: Sequence[Run]) -> None:
    for number, run in enumerate(runs):
        xs, ys = zip(*run.path, strict=True)
        label = f"{len(runs)} robot(s)" if number == 0 else None
        axes.plot(xs, ys, color=OURS, linewidth=0.8, alpha=0.6, label=label)
    ideal = list(path_of(punctual(plan.wanted)))
    axes.plot(*zip(*ideal, strict=True), color=IDEAL, linewidth=0.8, linestyle="--", label="ideal")
    axes.set_aspect("equal")
    axes.set(xlabel="x, m", ylabel="y, m", title="all ways")
    axes.legend(**BELOW)


def _draw_ends(axes: Axes, plan: Plan, runs: Sequence[Run]) -> None:
    ideal = end_of(punctual(plan.wanted))
    arrivals = [spiral_ends.arrival_end(run, plan.wanted) for run in spiral_ends.completed(runs)]
    for label, mark, colour, ends in (
        ("exact intervals, turtlesim's steps", "s", STEPS, stepped_ends(plan.wanted)),
        ("arrivals alone, no steps", "x", ARRIVALS, arrivals),
        ("robots", ".", OURS, spiral_ends.ends(runs)),
        ("ideal", "+", IDEAL, [ideal]),
    ):
        if ends:
            xs, ys = zip(*_from_mm(ideal, ends), strict=True)
            axes.scatter(
                xs, ys, marker=mark, color=colour, s=30, linewidths=1, alpha=0.8, label=label
            )
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x from the ideal end, mm", ylabel="y from the ideal end, mm", title="ends")
    axes.legend(**BELOW)


def _from_mm(ideal: Pose, ends: Sequence[Pose]) -> list[tuple[float, float]]:
    """Ends as seen from the ideal one, in mm; those that a picture could not tell apart are one."""
    seen = {((end.x - ideal.x) * 1000, (end.y - ideal.y) * 1000) for end in ends}
    return sorted({(round(x, 1), round(y, 1)) for x, y in seen})
