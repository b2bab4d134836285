"""What the page says of the spirals: where they ended, where their spread comes from, and what falls short. Pure."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Sequence

from sections import Section, quantile
from sim_robot.kinematics import STEP_S, Pose

from paper import spiral_course, spiral_ends
from paper.spiral_course import LENGTH_M, commanded_m, punctual, stepped_ends
from paper.spiral_ends import Run, Spread
from paper.spiral_files import files
from paper.spiral_plan import NETWORKS, PAPER_SIGMA_X_M, PAPER_SIGMA_Y_M, PAPERS, Plan
from paper.spiral_plots import plots
from paper.step import Comparison, Report, Results, failures, spread

# A standard deviation of fewer says nothing.
FEWEST = 2
NONE = "-"


def report(plan: Plan, results: Results) -> Report:
    """The page's part; of drives that failed or have not run there are none of the runs."""
    runs = spiral_ends.runs(results)
    return Report(
        sections=[_ends_section(plan, results, runs), _causes_section(plan, runs)],
        comparisons=_comparisons(plan, runs) if results else [],
        plots=plots(plan, runs),
        data=files(plan, runs),
        shortfalls=[*_failed(runs), *_explained(plan, runs)],
    )


def _ends_section(plan: Plan, results: Results, runs: Sequence[Run]) -> Section:
    text = (
        f"An operator's program publishes a twist at {spiral_course.RATE_HZ:g} Hz without looking at the "
        f"robot: {spiral_course.FIRST_SPEED_M_S:g} m/s and {spiral_course.SPEED_STEP_M_S:g} m/s more each "
        f"time, at {spiral_course.TURN_RAD_S:g} rad/s, until {LENGTH_M:g} m are commanded, then "
        f"zero.{_shortened(plan)} {_how_often(plan, results)} Each robot is the real agent and guard with "
        "a simulator of turtlesim's kinematics, behind an uplink of its own. The operators of one network "
        "share one uplink of the same kind. The guard of these robots waits 1 s for a command, because "
        "commands are 0.5 s apart. The position is read at the robot's own rosbridge. The ideal end is "
        "computed in closed form, for commands at exact intervals. A run is complete if the robot "
        "received each command once, in order, and then stopped."
    )
    table = [
        "| network | completed | sigma of x, m | sigma of y, m | off the ideal end, p50, mm | max, mm "
        "| travelled, m: least | mean | most |",
        "|---|---|---|---|---|---|---|---|---|",
        *(_ends_row(plan, network, spiral_ends.on(network, runs)) for network in NETWORKS),
        f"| the paper | 50 of 50 | {PAPER_SIGMA_X_M:.3f} | {PAPER_SIGMA_Y_M:.3f} | {NONE} | {NONE} | {NONE} "
        f"| {LENGTH_M:.3f} | {NONE} |",
    ]
    return Section("Ends of the spirals", text, table)


def _how_often(plan: Plan, results: Results) -> str:
    order = "all networks at once" if plan.networks_at_once else "one network after the other"
    ran = len(results) - len(failures(results))
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


def _ends_row(plan: Plan, network: str, runs: Sequence[Run]) -> str:
    done = spiral_ends.completed(runs)
    head = f"| {NETWORKS[network].name} | {len(done)} of {plan.runs} "
    if not done:
        return head + f"| {NONE} " * 7 + "|"
    off = [path * 1000 for path in spiral_ends.off_m(runs, _ideal(plan))]
    travelled = [run.travelled_m for run in done]
    return head + (
        f"| {_sigmas(spiral_ends.ends(runs))} | {quantile(off, 0.5):.1f} | {max(off):.1f} "
        f"| {min(travelled):.3f} | {statistics.fmean(travelled):.3f} | {max(travelled):.3f} |"
    )


def _causes_section(plan: Plan, runs: Sequence[Run]) -> Section:
    text = (
        f"turtlesim moves in steps of {STEP_S * 1000:g} ms and applies a command at its next step. "
        f'{_steps(plan)} The row "exact intervals" shows the effect of that alone: computed with the '
        'simulator\'s kinematics for all phases of its clock, without a network. "Same number of steps" '
        'keeps, of each network, only the runs with the commonest number of steps. "Arrivals alone" '
        "applies the commands at the times at which they came to the robot, to a robot that follows at "
        "once and without steps: this is the effect of the network and of Robotether. These three columns "
        "are sigma of x / of y. The last columns are times of the commands as the watching process saw "
        "them, on a machine that runs everything."
    )
    return Section("Where the spread comes from", text, _causes_table(plan, runs))


def _steps(plan: Plan) -> str:
    steps = punctual(plan.wanted)[-1].at_s / STEP_S
    if steps.is_integer():
        return f"The whole drive is {steps:g} steps."
    apart_mm = plan.wanted[-1].linear_x * STEP_S * 1000
    return (
        f"The whole drive is {steps:g} steps. So even commands at exact intervals move a robot for {int(steps)} or "
        f"{int(steps) + 1} of them, depending on its clock: ends that are {apart_mm:.0f} mm apart."
    )


def _causes_table(plan: Plan, runs: Sequence[Run]) -> list[str]:
    floor = stepped_ends(plan.wanted)
    return [
        "| network | driven, mm | same number of steps, mm | arrivals alone, mm | sigma between sendings, ms "
        "| sigma between arrivals, ms | on the way, p50, ms | p99, ms |",
        "|---|---|---|---|---|---|---|---|",
        *(_causes_row(plan, network, spiral_ends.on(network, runs)) for network in NETWORKS),
        f"| exact intervals | {_sigmas_mm(floor)} | {NONE} | 0.0 / 0.0 | 0.00 | 0.00 | {NONE} | {NONE} |",
    ]


def _causes_row(plan: Plan, network: str, runs: Sequence[Run]) -> str:
    done = spiral_ends.completed(runs)
    head = f"| {NETWORKS[network].name} "
    if not done:
        return head + f"| {NONE} " * 7 + "|"
    alike = spiral_ends.of_commonest_steps(runs)
    arrivals = [spiral_ends.arrival_end(run, plan.wanted) for run in done]
    late = [latency for run in done for latency in run.latencies_ms]
    return head + (
        f"| {_sigmas_mm(spiral_ends.ends(runs))} "
        f"| {_sigmas_mm(spiral_ends.ends(alike))} ({len(alike)} with {alike[0].steps} steps) "
        f"| {_sigmas_mm(arrivals)} "
        f"| {_sigma_between(run.sent_ms for run in done):.2f} "
        f"| {_sigma_between(run.arrived_ms for run in done):.2f} "
        f"| {quantile(late, 0.5):.1f} | {quantile(late, 0.99):.1f} |"
    )


def _comparisons(plan: Plan, runs: Sequence[Run]) -> list[Comparison]:
    rows = []
    for network, profile in NETWORKS.items():
        here = spiral_ends.on(network, runs)
        done = len(spiral_ends.completed(here))
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
            rows += _sigma_comparisons(profile.name, Spread.of(spiral_ends.ends(here)))
    return rows


def _sigma_comparisons(network: str, ours: Spread) -> list[Comparison]:
    return [
        Comparison(
            what=f"spiral, sigma of the final {axis}, {network}",
            against="paper",
            reference=paper_m,
            ours=ours_m,
            unit="m",
            better="lower",
        )
        for axis, paper_m, ours_m in (
            ("x", PAPER_SIGMA_X_M, ours.x_m),
            ("y", PAPER_SIGMA_Y_M, ours.y_m),
        )
    ]


def _failed(runs: Sequence[Run]) -> list[str]:
    """Of drives that failed as a whole the page tells itself."""
    return [reported for network in NETWORKS if (reported := spiral_ends.failed(network, runs))]


def _explained(plan: Plan, runs: Sequence[Run]) -> list[str]:
    """Why the ends spread more than the paper's, where they do."""
    found = ((network, spiral_ends.ends(spiral_ends.on(network, runs))) for network in PAPERS)
    spreads = [(network, Spread.of(ends)) for network, ends in found if len(ends) >= FEWEST]
    floor = Spread.of(stepped_ends(plan.wanted))
    return [
        f"The spirals' ends on {NETWORKS[network].name} spread by {ours.x_m:.3f} m in x and {ours.y_m:.3f} m in y, the "
        f"paper's by {PAPER_SIGMA_X_M:.3f} m and {PAPER_SIGMA_Y_M:.3f} m. Of commands at exact intervals turtlesim's "
        f"steps alone make {floor.x_m:.3f} m and {floor.y_m:.3f} m, unless all runs take the same number of them."
        for network, ours in spreads
        if plan.is_whole and (ours.x_m > PAPER_SIGMA_X_M or ours.y_m > PAPER_SIGMA_Y_M)
    ]


def _ideal(plan: Plan) -> Pose:
    return spiral_course.end_of(punctual(plan.wanted))


def _sigmas(ends: Sequence[Pose]) -> str:
    if len(ends) < FEWEST:
        return f"{NONE} | {NONE}"
    found = Spread.of(ends)
    return f"{found.x_m:.4f} | {found.y_m:.4f}"


def _sigmas_mm(ends: Sequence[Pose]) -> str:
    if len(ends) < FEWEST:
        return NONE
    found = Spread.of(ends)
    return f"{found.x_m * 1000:.1f} / {found.y_m * 1000:.1f}"


def _sigma_between(runs: Iterable[Sequence[float]]) -> float:
    return spread([interval for times in runs for interval in spiral_ends.intervals_ms(times)])
