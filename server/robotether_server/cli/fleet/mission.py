"""One command on many robots: connects, runs it, and makes an outcome of whatever happens."""

import logging
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from time import monotonic

from robotether_server.cli.fleet import remote, ssh_settings
from robotether_server.cli.fleet.connections import Connections
from robotether_server.cli.fleet.crew import Crew
from robotether_server.cli.fleet.outcomes import Outcome
from robotether_server.cli.fleet.output import Kept, Lines, Sink
from robotether_server.cli.fleet.problems import FleetProblem

log = logging.getLogger(__name__)

ENDING_WITHIN_S = 3.0

Sinks = Callable[[str], tuple[Sink, Sink]]


@dataclass(frozen=True)
class Order:
    """What shall run, and how. `command` is what the robot's login shell gets."""

    command: str
    timeout_s: float
    config: Path | None = None
    password: str | None = None
    accept_new: bool = False


class Mission:
    """One run on some robots; `interrupted` when the person ended it before its end."""

    def __init__(self, order: Order, robots: Sequence[str], parallel: int, sinks: Sinks) -> None:
        self._order = order
        self._robots = robots
        self._sinks = sinks
        self._connections = Connections(accept_new=order.accept_new)
        self._crew = Crew(self._on, robots, parallel)
        self.interrupted = False

    def run(self) -> list[Outcome]:
        """Run to the end, or until Ctrl-C, which ends the command on every robot; return one outcome a robot."""
        outcomes: list[Outcome] = []
        try:
            outcomes.extend(self._crew.results())
        except KeyboardInterrupt:
            self.interrupted = True
            self._connections.close_all()
            outcomes.extend(self._crew.stop(ENDING_WITHIN_S))
        finally:
            self._connections.close_all()
        missing = set(self._robots) - {outcome.robot for outcome in outcomes}
        return outcomes + [Outcome(name, None, 0, "interrupted") for name in sorted(missing)]

    def _on(self, robot: str) -> Outcome:
        begun = monotonic()
        out, err = self._sinks(robot)
        status, problem = None, None
        try:
            with closing(out), closing(err):
                status = self._command(robot, out, err)
        except FleetProblem as error:
            problem = "interrupted" if self.interrupted else error.detail
        except Exception as error:
            # The border of one robot: the others go on.
            log.exception("robot %s", robot)
            problem = f"failed: {error!r}"
        kept_out, kept_err = (sink if isinstance(sink, Kept) else None for sink in (out, err))
        return Outcome(robot, status, monotonic() - begun, problem, kept_out, kept_err)

    def _command(self, robot: str, out: Sink, err: Sink) -> int:
        order = self._order
        target = ssh_settings.resolve(robot, order.config)
        connection = self._connections.open(target)
        try:
            return remote.run(
                connection,
                order.command,
                out=out,
                err=err,
                timeout_s=order.timeout_s,
                password=order.password,
            )
        finally:
            self._connections.close(connection)


def to_terminal(robots: Sequence[str]) -> Sinks:
    """Return sinks that print each line at once, after its robot's name."""
    width = max(map(len, robots))
    lock = Lock()

    def sinks(robot: str) -> tuple[Sink, Sink]:
        prefix = f"{robot.ljust(width)} | "
        return Lines(prefix, sys.stdout, lock), Lines(prefix, sys.stderr, lock)

    return sinks


def kept(_robot: str) -> tuple[Sink, Sink]:
    """Return sinks that keep what comes."""
    return Kept(), Kept()
