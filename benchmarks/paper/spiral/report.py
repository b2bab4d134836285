"""What the page says of the spirals: where they ended, where their spread comes from, and what falls short. Pure."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Sequence
from functools import partial
from itertools import zip_longest
from typing import TYPE_CHECKING

from numpy import quantile
from sections import NONE, Section
from sim_robot.kinematics import STEP_S, Pose

from paper.spiral import course, ends
from paper.spiral.course import (
    LENGTH_M,
    NETWORKS,
    PAPER_SIGMA_X_M,
    PAPER_SIGMA_Y_M,
    PAPERS,
    Plan,
    commanded_m,
    end_of,
    path_of,
    punctual,
    stepped_ends,
)
from paper.spiral.ends import Run, Spread
from paper.step import Comparison, Data, Plot, Report, Results, spread, succeeded

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

# Of each way every sixth step goes to the file, 10 a second: each second one of those that were kept.
MAX_STEPS, THIN = 3, 2
# A millimetre.
DIGITS = 3
SIZE_INCH = (10.0, 5.2)
# Where it hides no robot.
BELOW = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.12), "ncols": 2, "fontsize": "small"}
OURS, IDEAL, STEPS, ARRIVALS = "tab:blue", "black", "tab:orange", "tab:green"
# A standard deviation of fewer says nothing.
FEWEST = 2


def files(plan: Plan, runs: Sequence[Run]) -> list[Data]:
    """The ends of all runs, when their commands arrived, and each network's ways."""
    if not runs:
        return []
    paths = [_paths(network, here) for network in NETWORKS if (here := ends.on(network, runs))]
    return [_ends(plan, runs), _arrivals(runs), *paths]


def _ends(plan: Plan, runs: Sequence[Run]) -> Data:
    ideal = end_of(punctual(plan.wanted))
    return Data(
        name="spiral-ends",
        about=(
            "where each robot came to stand, seen from its start, m and rad; the ideal end is "
            f"x {ideal.x:.6f} m, y {ideal.y:.6f} m; x_arrivals, y_arrivals: of a robot without steps that follows the "
            "commands as they arrived; what nobody saw is empty"
        ),
        header=(
            *("network", "repetition", "pair", "failure", "x_m", "y_m", "theta_rad", "steps"),
            *("travelled_m", "x_arrivals_m", "y_arrivals_m"),
        ),
        rows=[_end_row(plan, run) for run in runs],
    )


def _end_row(plan: Plan, run: Run) -> list[object]:
    arrivals = None if run.failure else ends.arrival_end(run, plan.wanted)
    theta = "" if run.end is None else f"{run.end.theta:.6f}"
    return [
        run.network,
        run.repetition,
        run.pair,
        run.failure,
        *_pose(run.end),
        theta,
        run.steps,
        f"{run.travelled_m:.6f}",
        *_pose(arrivals),
    ]


def _pose(pose: Pose | None) -> tuple[str, str]:
    return ("", "") if pose is None else (f"{pose.x:.6f}", f"{pose.y:.6f}")


def _arrivals(runs: Sequence[Run]) -> Data:
    times = [[f"{at:.2f}" for at in each] for run in runs for each in (run.sent_ms, run.arrived_ms)]
    header = [f"{_title(run)}-{what}" for run in runs for what in ("sent", "arrived")]
    return Data(
        name="spiral-arrivals",
        about=(
            "when each command was sent and when it arrived at the robot, in ms from the run's first sending; a column "
            "pair a run (NETWORK-REPETITION-PAIR)"
        ),
        header=["command", *header],
        rows=[[n, *row] for n, row in enumerate(zip_longest(*times, fillvalue=""))],
    )


def _paths(network: str, runs: Sequence[Run]) -> Data:
    columns = [
        [f"{point[axis]:.{DIGITS}f}" for point in run.path[::THIN]]
        for run in runs
        for axis in (0, 1)
    ]
    step_s = STEP_S * MAX_STEPS * THIN
    return Data(
        name=f"spiral-ways-{network}",
        about=(
            f"where the robots on {NETWORKS[network].name} were, in m from their starts, {1 / step_s:.1f} times "
            "a second since each began to move; a column pair a run (NETWORK-REPETITION-PAIR)"
        ),
        header=["time_s", *(f"{_title(run)}-{axis}" for run in runs for axis in ("x", "y"))],
        rows=[
            [f"{n * step_s:.3f}", *row] for n, row in enumerate(zip_longest(*columns, fillvalue=""))
        ],
    )


def _title(run: Run) -> str:
    return f"{run.network}-{run.repetition}-{run.pair}"


def plots(plan: Plan, runs: Sequence[Run]) -> list[Plot]:
    """One for each network on which a robot was seen to drive."""
    found = []
    for network, profile in NETWORKS.items():
        if here := [run for run in ends.on(network, runs) if run.path]:
            done = len(ends.completed(here))
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
    arrivals = [ends.arrival_end(run, plan.wanted) for run in ends.completed(runs)]
    for label, mark, colour, poses in (
        ("exact intervals, turtlesim's steps", "s", STEPS, stepped_ends(plan.wanted)),
        ("arrivals alone, no steps", "x", ARRIVALS, arrivals),
        ("robots", ".", OURS, ends.ends(runs)),
        ("ideal", "+", IDEAL, [ideal]),
    ):
        if poses:
            xs, ys = zip(*_from_mm(ideal, poses), strict=True)
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


def report(plan: Plan, results: Results) -> Report:
    """The chapter; of drives that failed or have not run there are none of the runs."""
    runs = ends.runs(results)
    return Report(
        sections=[_ends_section(plan, results, runs), _causes_section(plan, runs)],
        comparisons=_comparisons(plan, runs) if results else [],
        plots=plots(plan, runs),
        data=files(plan, runs),
        shortfalls=[*_failed(runs), *_explained(plan, runs)],
    )


def _ends_section(plan: Plan, results: Results, runs: Sequence[Run]) -> Section:
    text = (
        f"An operator's program publishes a twist at {course.RATE_HZ:g} Hz without looking at the robot: "
        f"{course.FIRST_SPEED_M_S:g} m/s and {course.SPEED_STEP_M_S:g} m/s more each time, at "
        f"{course.TURN_RAD_S:g} rad/s, until {LENGTH_M:g} m are commanded, then zero.{_shortened(plan)} "
        f"{_how_often(plan, results)} Each robot is the real agent and guard with a simulator of turtlesim's "
        "kinematics, behind an uplink of its own. The operators of one network share one uplink of the same kind. The "
        "guard waits 1 s for a command, because commands are 0.5 s apart. The position is read at the robot's own "
        "rosbridge. The ideal end is computed for commands at exact intervals. A run is complete if the robot received "
        "each command once, in order, and then stopped."
    )
    columns = (
        "network | completed | sigma of x, m | sigma of y, m | off the ideal end, p50, mm | max, mm "
        "| travelled, m: least | mean | most"
    )
    sigmas = (f"{one:.3f}" for one in (PAPER_SIGMA_X_M, PAPER_SIGMA_Y_M))
    papers = ("the paper", "50 of 50", *sigmas, NONE, NONE, NONE, f"{LENGTH_M:.3f}", NONE)
    rows = [_ends_row(plan, network, ends.on(network, runs)) for network in NETWORKS]
    return Section("Ends of the spirals", text, columns, [*rows, papers])


def _how_often(plan: Plan, results: Results) -> str:
    order = "all networks at once" if plan.networks_at_once else "one network after the other"
    ran = len(succeeded(results))
    return (
        f"{plan.pairs} pair(s) drive at the same time, on {len(NETWORKS)} networks, {order}, {plan.repetitions} "
        f"time(s): {ran} of {len(plan.drives)} such drives were measured."
    )


def _shortened(plan: Plan) -> str:
    if plan.is_whole:
        return ""
    return (
        f" This run drove only the first {plan.duration_s:g} s of it "
        f"({commanded_m(plan.wanted):.3f} m), so its ends are not compared with the paper's."
    )


def _ends_row(plan: Plan, network: str, runs: Sequence[Run]) -> tuple[str, ...]:
    done = ends.completed(runs)
    head = (NETWORKS[network].name, f"{len(done)} of {plan.runs}")
    if not done:
        return *head, *[NONE] * 7
    off = [path * 1000 for path in ends.off_m(runs, end_of(punctual(plan.wanted)))]
    travelled = [run.travelled_m for run in done]
    return (
        *head,
        *_sigmas(ends.ends(runs)),
        *(f"{mm:.1f}" for mm in (quantile(off, 0.5), max(off))),
        *(f"{m:.3f}" for m in (min(travelled), statistics.fmean(travelled), max(travelled))),
    )


def _causes_section(plan: Plan, runs: Sequence[Run]) -> Section:
    text = (
        f"turtlesim moves in steps of {STEP_S * 1000:g} ms and applies a command at its next step. "
        f'{_steps(plan)} The row "exact intervals" shows the effect of that alone: computed with the simulator\'s '
        'kinematics for all phases of its clock, without a network. "Same number of steps" keeps, of each network, '
        'only the runs with the commonest number of steps. "Arrivals alone" applies the commands when they came to a '
        "robot that follows at once and without steps: this is the effect of the network and of Robotether. These "
        "three columns are sigma of x / of y. The last columns are times of the commands as the watching process saw "
        "them, on a machine that runs everything."
    )
    columns = (
        "network | driven, mm | same number of steps, mm | arrivals alone, mm | sigma between sendings, ms "
        "| sigma between arrivals, ms | on the way, p50, ms | p99, ms"
    )
    floor = _sigmas_mm(stepped_ends(plan.wanted))
    exact = ("exact intervals", floor, NONE, "0.0 / 0.0", "0.00", "0.00", NONE, NONE)
    rows = [_causes_row(plan, network, ends.on(network, runs)) for network in NETWORKS]
    return Section("Where the spread comes from", text, columns, [*rows, exact])


def _steps(plan: Plan) -> str:
    steps = punctual(plan.wanted)[-1].at_s / STEP_S
    if steps.is_integer():
        return f"The whole drive is {steps:g} steps."
    apart_mm = plan.wanted[-1].linear_x * STEP_S * 1000
    return (
        f"The whole drive is {steps:g} steps. So even commands at exact intervals move a robot for {int(steps)} or "
        f"{int(steps) + 1} of them, depending on its clock: ends that are {apart_mm:.0f} mm apart."
    )


def _causes_row(plan: Plan, network: str, runs: Sequence[Run]) -> tuple[str, ...]:
    done = ends.completed(runs)
    if not done:
        return NETWORKS[network].name, *[NONE] * 7
    alike = ends.of_commonest_steps(runs)
    arrivals = [ends.arrival_end(run, plan.wanted) for run in done]
    late = [latency for run in done for latency in run.latencies_ms]
    return (
        NETWORKS[network].name,
        _sigmas_mm(ends.ends(runs)),
        f"{_sigmas_mm(ends.ends(alike))} ({len(alike)} with {alike[0].steps} steps)",
        _sigmas_mm(arrivals),
        f"{_sigma_between(run.sent_ms for run in done):.2f}",
        f"{_sigma_between(run.arrived_ms for run in done):.2f}",
        *(f"{ms:.1f}" for ms in quantile(late, (0.5, 0.99))),
    )


def _comparisons(plan: Plan, runs: Sequence[Run]) -> list[Comparison]:
    rows = []
    for network, profile in NETWORKS.items():
        here = ends.on(network, runs)
        done = len(ends.completed(here))
        rows.append(
            Comparison(
                what=f"spirals driven to the end, {profile.name}",
                against="paper" if network in PAPERS else "all",
                reference=100.0,
                ours=100.0 * done / plan.runs,
                unit="%",
                better="equal",
            )
        )
        if network in PAPERS and plan.is_whole and done >= FEWEST:
            ours = Spread.of(ends.ends(here))
            axes = (("x", PAPER_SIGMA_X_M, ours.x_m), ("y", PAPER_SIGMA_Y_M, ours.y_m))
            rows += [
                Comparison(
                    what=f"spiral, sigma of the final {axis}, {profile.name}",
                    against="paper",
                    reference=paper_m,
                    ours=ours_m,
                    unit="m",
                    better="lower",
                )
                for axis, paper_m, ours_m in axes
            ]
    return rows


def _failed(runs: Sequence[Run]) -> list[str]:
    """Of drives that failed as a whole the page tells itself."""
    return [reported for network in NETWORKS if (reported := ends.failed(network, runs))]


def _explained(plan: Plan, runs: Sequence[Run]) -> list[str]:
    """Why the ends spread more than the paper's, where they do."""
    found = ((network, ends.ends(ends.on(network, runs))) for network in PAPERS)
    spreads = [(network, Spread.of(ends)) for network, ends in found if len(ends) >= FEWEST]
    floor = Spread.of(stepped_ends(plan.wanted))
    return [
        f"The spirals' ends on {NETWORKS[network].name} spread by {ours.x_m:.3f} m in x and {ours.y_m:.3f} m in y, the "
        f"paper's by {PAPER_SIGMA_X_M:.3f} m and {PAPER_SIGMA_Y_M:.3f} m. Of commands at exact intervals turtlesim's "
        f"steps alone make {floor.x_m:.3f} m and {floor.y_m:.3f} m, unless all runs take the same number of them."
        for network, ours in spreads
        if plan.is_whole and (ours.x_m > PAPER_SIGMA_X_M or ours.y_m > PAPER_SIGMA_Y_M)
    ]


def _sigmas(ends: Sequence[Pose]) -> tuple[str, str]:
    if len(ends) < FEWEST:
        return NONE, NONE
    found = Spread.of(ends)
    return f"{found.x_m:.4f}", f"{found.y_m:.4f}"


def _sigmas_mm(ends: Sequence[Pose]) -> str:
    if len(ends) < FEWEST:
        return NONE
    found = Spread.of(ends)
    return f"{found.x_m * 1000:.1f} / {found.y_m * 1000:.1f}"


def _sigma_between(runs: Iterable[Sequence[float]]) -> float:
    return spread([interval for times in runs for interval in ends.intervals_ms(times)])
