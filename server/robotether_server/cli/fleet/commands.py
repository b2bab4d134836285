"""robotether fleet run and list: one command on many robots, so many at a time, and its result on each.

Robots are the entries of OpenSSH's configuration that `robotether ssh-config` printed. They are known by their
`HostKeyAlias robotether-NAME`, so a pattern such as `*` reaches no other host of the person.
"""

import glob
import logging
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from time import monotonic
from typing import Generic, TypeVar

import click

from robotether_server.cli.common import JSON, print_json, print_table
from robotether_server.cli.fleet import remote, ssh
from robotether_server.cli.fleet.problems import ConfigUnusable, FleetProblem, RobotsUnknown
from robotether_server.cli.fleet.remote import Captured, Lines, Sink
from robotether_server.cli.fleet.ssh import SshConnections

USER_CONFIG = Path("~/.ssh/config")
ALIAS = "robotether-"
MAX_INCLUDE_DEPTH = 16  # OpenSSH's own bound


T = TypeVar("T")
CLOSED_WITHIN_S = 3.0
INTERRUPTED = 130  # a shell's exit status for a command that Ctrl-C ended
MAX_PARALLEL = 200
ON = click.option(
    "--on",
    "patterns",
    multiple=True,
    required=True,
    metavar="GLOB",
    help="Names of robots, such as 'sim*'; may be given more than once.",
)
SSH_CONFIG = click.option(
    "--ssh-config",
    "config",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Where `robotether ssh-config` was written.  [default: ~/.ssh/config and what it includes]",
)


def choose(config: Path | None, patterns: Iterable[str]) -> list[str]:
    """Return the robots that a pattern names, by name; raise RobotsUnknown for a pattern without any."""
    path = (config or USER_CONFIG).expanduser()
    known = sorted(robots_in(path))
    chosen: set[str] = set()
    for pattern in patterns:
        found = [name for name in known if fnmatchcase(name, pattern)]
        if not found:
            names = ", ".join(known) or "no robot at all"
            raise RobotsUnknown(
                f"cannot find robots for {pattern}: {path} has {names}; update it with: robotether ssh-config"
            )
        chosen.update(found)
    return sorted(chosen)


def robots_in(path: Path) -> set[str]:
    """Return the names of all robots of a configuration and of what it includes."""
    names: list[str] = []
    robots: set[str] = set()
    for keyword, arguments in directives(path):
        if keyword in ("host", "match"):
            names = [name for name in arguments if keyword == "host" and is_plain(name)]
        elif keyword == "hostkeyalias" and arguments and arguments[0].startswith(ALIAS):
            robots.update(names)
    return robots


def is_plain(name: str) -> bool:
    """Tell whether a `Host` is a name and not a pattern."""
    return not set(name) & set("*?!")


def directives(path: Path, depth: int = 0) -> Iterator[tuple[str, list[str]]]:
    """Yield each keyword in lower case with its arguments; an included file is read at its Include."""
    if depth > MAX_INCLUDE_DEPTH:
        raise ConfigUnusable(f"cannot read {path}: it is included over {MAX_INCLUDE_DEPTH} deep")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigUnusable(
            f"cannot read {path}: {error}; write it with: robotether ssh-config, or name another with --ssh-config"
        ) from error
    for line in text.splitlines():
        keyword, arguments = words(line)
        if keyword == "include":
            for included in (part for pattern in arguments for part in matches(pattern)):
                yield from directives(included, depth + 1)
        elif keyword:
            yield keyword, arguments


def words(line: str) -> tuple[str, list[str]]:
    """Split `Keyword argument "another one"` or `Keyword=argument`; an empty line gives an empty keyword."""
    try:
        parts = shlex.split(line, comments=True)
    except ValueError:
        return "", []
    if not parts:
        return "", []
    keyword, equals, rest = parts[0].partition("=")
    return keyword.lower(), [rest, *parts[1:]] if equals and rest else parts[1:]


def matches(pattern: str) -> list[Path]:
    """Return the files that an `Include` means; names without a folder are below ~/.ssh."""
    full = Path("~/.ssh").expanduser() / Path(pattern).expanduser()
    return [Path(name) for name in sorted(glob.glob(str(full)))]  # noqa: PTH207 - the pattern may be absolute


@dataclass(frozen=True)
class Outcome:
    """One robot's result. `status` None: the command did not finish, and `problem` says why."""

    robot: str
    status: int | None
    seconds: float
    problem: str | None = None
    out: Captured | None = None
    err: Captured | None = None

    @property
    def ok(self) -> bool:
        """Whether the command succeeded."""
        return self.status == 0

    @property
    def result(self) -> str:
        """The text in the table."""
        if self.status is None:
            return self.problem or "unknown"
        return "ok" if self.ok else f"exit status {self.status}"


def as_dict(outcome: Outcome) -> dict[str, object]:
    """Return what --json prints of it."""
    out, err = outcome.out or Captured(), outcome.err or Captured()
    return {
        "robot": outcome.robot,
        "ok": outcome.ok,
        "status": outcome.status,
        "problem": outcome.problem,
        "seconds": round(outcome.seconds, 3),
        "stdout": out.text,
        "stderr": err.text,
        "cut": out.cut or err.cut,
    }


def as_rows(outcomes: Sequence[Outcome]) -> list[tuple[str, str, str]]:
    """Return the table's rows, failures last: they are next to the prompt."""
    ordered = sorted(outcomes, key=lambda outcome: (not outcome.ok, outcome.robot))
    return [(one.robot, f"{one.seconds:.1f}", one.result) for one in ordered]


def verdict(outcomes: Sequence[Outcome]) -> str:
    """Return the last line: how many succeeded."""
    good = sum(outcome.ok for outcome in outcomes)
    return f"{good} of {len(outcomes)} robots: ok"


class WorkerPool(Generic[T]):
    """Does one thing for many robots at once; `work` is called once for each name, and must not raise.

    Its threads are daemons: one that hangs in a dead network must not delay the end after Ctrl-C.
    """

    def __init__(self, work: Callable[[str], T], names: Sequence[str], parallel: int) -> None:
        self._work = work
        self._size = len(names)
        self._waiting: SimpleQueue[str] = SimpleQueue()
        self._done: SimpleQueue[T] = SimpleQueue()
        for name in names:
            self._waiting.put(name)
        self._threads = [
            Thread(target=self._work_off, daemon=True) for _ in range(min(parallel, len(names)))
        ]

    def results(self) -> Iterator[T]:
        """Start, and yield each result as it comes."""
        for thread in self._threads:
            thread.start()
        for _ in range(self._size):
            yield self._done.get()

    def stop(self, within_s: float) -> list[T]:
        """Begin nothing new; return what those at work still bring within that time."""
        end = monotonic() + within_s
        while self._next() is not None:
            pass
        for thread in self._threads:
            thread.join(max(0, end - monotonic()))
        late = []
        while not self._done.empty():
            late.append(self._done.get())
        return late

    def _work_off(self) -> None:
        while (name := self._next()) is not None:
            self._done.put(self._work(name))

    def _next(self) -> str | None:
        try:
            return self._waiting.get_nowait()
        except Empty:
            return None


log = logging.getLogger(__name__)


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
            outcomes.extend(self._workers.stop(CLOSED_WITHIN_S))
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
        target = ssh.resolve(robot, command.config)
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


@click.group()
def fleet() -> None:
    """Run commands on many robots at once.

    Robots are the entries that `robotether ssh-config` printed, and what works with `ssh NAME` works here:
    the same files, keys, ssh-agent and known host keys.
    """
    # The command reports the error itself, once; paramiko would add a traceback.
    logging.getLogger("paramiko").setLevel(logging.CRITICAL)


@fleet.command("list")
@ON
@SSH_CONFIG
@JSON
def list_robots(patterns: tuple[str, ...], config: Path | None, as_json: bool) -> None:
    """List the robots that a pattern names, and how they are reached; connects to none."""
    chosen = choose(config, patterns)
    targets = [ssh.resolve(name, config) for name in chosen]
    rows = [
        (one.name, one.user, str(one.port), f"{one.jump.host}:{one.jump.port}" if one.jump else "-")
        for one in targets
    ]
    heads = ("ROBOT", "USER", "PORT", "THROUGH")
    if as_json:
        print_json([dict(zip(map(str.lower, heads), row, strict=True)) for row in rows])
    else:
        print_table(heads, rows)


@fleet.command()
@click.argument("command", metavar="COMMAND")
@ON
@SSH_CONFIG
@click.option(
    "--parallel",
    type=click.IntRange(1, MAX_PARALLEL),
    default=20,
    show_default=True,
    help="On how many robots at a time.",
)
@click.option(
    "--timeout",
    "timeout_s",
    type=click.FloatRange(min=0, min_open=True),
    default=300,
    show_default=True,
    metavar="SECONDS",
    help="End the command on a robot after this time.",
)
@click.option("--sudo", is_flag=True, help="Run it as root; sudo must ask no password.")
@click.option("--ask-sudo-password", is_flag=True, help="Ask for a password for all sudos, once.")
@click.option(
    "--accept-new",
    is_flag=True,
    help="Trust and save unknown host keys; a changed one is never trusted.",
)
@JSON
def run(
    *,
    command: str,
    patterns: tuple[str, ...],
    config: Path | None,
    parallel: int,
    timeout_s: float,
    sudo: bool,
    ask_sudo_password: bool,
    accept_new: bool,
    as_json: bool,
) -> None:
    """Run COMMAND in the login shell of each robot.

    Prints each line as it comes, after its robot's name, and then a table on standard error. Exit status 0: it
    succeeded on all. Ctrl-C and a time-out end it on the robots, too. There is no standard input.

    For example: robotether fleet run 'systemctl restart ros' --on 'sim*' --on turtle --sudo
    """
    chosen = choose(config, patterns)
    password = (
        click.prompt("sudo password", hide_input=True, err=True) if ask_sudo_password else None
    )
    sudo = sudo or ask_sudo_password
    remote_command = Command(
        line=remote.on_lifeline(command, sudo=sudo, password=password is not None),
        timeout_s=timeout_s,
        config=config,
        password=password,
        accept_new=accept_new,
    )
    fleet_run = FleetRun(
        remote_command, chosen, parallel, captured if as_json else to_terminal(chosen)
    )
    found = fleet_run.run()
    if as_json:
        print_json([as_dict(one) for one in sorted(found, key=lambda one: one.robot)])
    else:
        print_summary(found)
    if fleet_run.interrupted:
        sys.exit(INTERRUPTED)
    sys.exit(0 if all(one.ok for one in found) else 1)


def print_summary(found: list[Outcome]) -> None:
    """Print the table where it is in nobody's way who reads the robots' output."""
    click.echo(err=True)
    print_table(("ROBOT", "SECONDS", "RESULT"), as_rows(found), err=True)
    click.echo(verdict(found), err=True)
