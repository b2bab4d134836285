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
from robotether_server.cli.fleet.connections import SshConnections
from robotether_server.cli.fleet.outcomes import Outcome
from robotether_server.cli.fleet.output import Captured, Lines, Sink
from robotether_server.cli.fleet.problems import FleetProblem
from robotether_server.cli.fleet.worker_pool import WorkerPool

log = logging.getLogger(__name__)

ENDING_WITHIN_S = 3.0

Sinks = Callable[[str], tuple[Sink, Sink]]


@dataclass(frozen=True)
class Command:
    """What shall run, and how. `line` is what the robot's login shell gets."""

    line: str
    timeout_s: float
    config: Path | None = None
    password: str | None = None
    accept_new: bool = False


class FleetRun:
    """One run on some robots; `interrupted` when the person ended it before its end."""

    def __init__(
        self, command: Command, robots: Sequence[str], parallel: int, sinks: Sinks
    ) -> None:
        self._command = command
        self._robots = robots
        self._sinks = sinks
        self._connections = SshConnections(accept_new=command.accept_new)
        self._workers = WorkerPool(self._on, robots, parallel)
        self.interrupted = False

    def run(self) -> list[Outcome]:
        """Run to the end, or until Ctrl-C, which ends the command on every robot; return one outcome a robot."""
        outcomes: list[Outcome] = []
        try:
            outcomes.extend(self._workers.results())
        except KeyboardInterrupt:
            self.interrupted = True
            self._connections.close_all()
            outcomes.extend(self._workers.stop(ENDING_WITHIN_S))
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
                status = self._run_on(robot, out, err)
        except FleetProblem as error:
            problem = "interrupted" if self.interrupted else error.detail
        except Exception as error:
            # The border of one robot: the others go on.
            log.exception("robot %s", robot)
            problem = f"failed: {error!r}"
        kept_out, kept_err = (sink if isinstance(sink, Captured) else None for sink in (out, err))
        return Outcome(robot, status, monotonic() - begun, problem, kept_out, kept_err)

    def _run_on(self, robot: str, out: Sink, err: Sink) -> int:
        command = self._command
        target = ssh_settings.resolve(robot, command.config)
        connection = self._connections.open(target)
        try:
            return remote.run(
                connection,
                command.line,
                out=out,
                err=err,
                timeout_s=command.timeout_s,
                password=command.password,
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


def captured(_robot: str) -> tuple[Sink, Sink]:
    """Return sinks that keep what comes."""
    return Captured(), Captured()
