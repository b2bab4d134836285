"""The spirals' raw data, as CSV files beside the page. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest

from sim_robot.kinematics import STEP_S, Pose

from paper import spiral_ends
from paper.spiral_course import end_of, punctual
from paper.spiral_ends import Run
from paper.spiral_plan import NETWORKS, Plan
from paper.step import Data

# Of each way every sixth step goes to the file, 10 a second: each second one of those that were kept.
MAX_STEPS, THIN = 3, 2
# A millimetre.
DIGITS = 3


def files(plan: Plan, runs: Sequence[Run]) -> list[Data]:
    """The ends of all runs, when their commands arrived, and each network's ways."""
    if not runs:
        return []
    paths = [
        _paths(network, here) for network in NETWORKS if (here := spiral_ends.on(network, runs))
    ]
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
            "network",
            "repetition",
            "pair",
            "failure",
            "x_m",
            "y_m",
            "theta_rad",
            "steps",
            "travelled_m",
            "x_arrivals_m",
            "y_arrivals_m",
        ),
        rows=[_end_row(plan, run) for run in runs],
    )


def _end_row(plan: Plan, run: Run) -> list[object]:
    arrivals = None if run.failure else spiral_ends.arrival_end(run, plan.wanted)
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
