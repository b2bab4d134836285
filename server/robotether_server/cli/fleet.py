"""robotether fleet run and list: one command on many robots, some at a time, and its result on each.

Started by a person on a machine of their own; needs OpenSSH's client, whose configuration it reads, and no database.
Robots are the entries that `robotether ssh-config` printed. They are known by their `HostKeyAlias robotether-NAME`, so
a pattern such as `*` reaches no other host of the person.

sshd leaves a command running when its client disconnects. So a small watcher beside the command reads standard input
and ends the process group when it closes, including what sudo started. Output is passed on in whole lines, each with
its robot's name. Control characters are escaped: a robot must not control the operator's terminal.
"""

import contextlib
import logging
import shlex
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from time import monotonic
from typing import IO, TextIO

import click
import fabric
import paramiko
from fabric.runners import Remote
from invoke.exceptions import CommandTimedOut, ThreadException

from robotether_server.cli import fleet_ssh
from robotether_server.cli.common import JSON, print_json, print_table
from robotether_server.cli.fleet_ssh import FleetError, SshConnections
from robotether_server.problems import reason_in

MAX_LINE_LENGTH = 16 * 1024
MAX_CAPTURED_LENGTH = 1024 * 1024
MAX_PARALLEL = 200
POLL_S = 0.05
CLOSED_WITHIN_S = 3.0
# Exit status of a shell for a command that Ctrl-C ended.
INTERRUPTED = 130
ENDED_WITHOUT_STATUS = -1
# One line, because some login shells take no line break between quotes. $1 is the command.
LIFELINE = (
    "exec 3<&0 </dev/null; "
    "{ while read -r _ <&3; do :; done; kill -TERM 0; } >/dev/null 2>&1 & "
    '"${SHELL:-/bin/sh}" -c "$1" 3<&-; status=$?; kill "$!" 2>/dev/null; exit "$status"'
)
_ESCAPES = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160)) if chr(code) != "\t"}

log = logging.getLogger(__name__)


class Lines:
    """One robot's standard output or error, which comes in pieces."""

    def __init__(self, prefix: str, to: TextIO, lock: Lock) -> None:
        self._prefix = prefix
        self._to = to
        self._lock = lock
        self._rest = ""

    def write(self, text: str) -> None:
        """Pass on the lines that are whole now; one without an end is cut at MAX_LINE_LENGTH."""
        *lines, rest = (self._rest + text).split("\n")
        while len(rest) > MAX_LINE_LENGTH:
            lines.append(rest[:MAX_LINE_LENGTH])
            rest = rest[MAX_LINE_LENGTH:]
        self._rest = rest
        self._pass_on(lines)

    def close(self) -> None:
        """Pass on a last line without an end."""
        rest, self._rest = self._rest, ""
        if rest:
            self._pass_on([rest])

    def _pass_on(self, lines: list[str]) -> None:
        with self._lock:
            for line in lines:
                self._to.write(f"{self._prefix}{line.removesuffix(chr(13)).translate(_ESCAPES)}\n")
            self._to.flush()


class Captured:
    """The first MAX_CAPTURED_LENGTH characters of an output, for --json."""

    def __init__(self) -> None:
        self.text = ""
        self.cut = False

    def write(self, text: str) -> None:
        """Keep what has room."""
        room = MAX_CAPTURED_LENGTH - len(self.text)
        self.text += text[:room]
        self.cut = self.cut or len(text) > room

    def close(self) -> None:
        """There is nothing more to come."""


# Where one output of one robot goes.
Sink = Lines | Captured


def on_lifeline(command: str, *, sudo: bool = False, password: bool = False) -> str:
    """Return what to send to the robot's login shell."""
    asking = ["-S", "-p", ""] if password else ["-n"]
    before = ["sudo", *asking, "--"] if sudo else []
    return shlex.join([*before, "sh", "-c", LIFELINE, "robotether", command])


class Runner(Remote):  # type: ignore[misc] # fabric has no types
    """fabric's runner, which keeps standard input open and no copy of what it has passed on."""

    input_sleep = POLL_S

    def __init__(self, connection: fabric.Connection, password: str | None) -> None:
        super().__init__(connection, inline_env=True)
        self._password = password
        self._is_out_of_time = False

    def kill(self) -> None:
        """Close the channel, because the time is over: the only reason for which the timer of invoke calls this."""
        self._is_out_of_time = True
        super().kill()

    @property
    def timed_out(self) -> bool:
        """Whether the timer ended the command; invoke asks whether its thread has ended, which may be too soon."""
        return self._is_out_of_time

    def send_start_message(self, command: str) -> None:
        """Start the command; the first line is for sudo, or else for the watcher, which takes no notice."""
        super().send_start_message(command)
        if self._password is not None:
            # A command that has ended already reads nothing; its status says how.
            with contextlib.suppress(OSError):
                self.channel.sendall(f"{self._password}\n".encode())

    def handle_stdout(self, buffer_: list[str], hide: bool, output: IO[str]) -> None:
        """Pass standard output on."""
        for text in self.read_proc_output(self.read_proc_stdout):
            output.write(text)

    def handle_stderr(self, buffer_: list[str], hide: bool, output: IO[str]) -> None:
        """Pass standard error on."""
        for text in self.read_proc_output(self.read_proc_stderr):
            output.write(text)


def run_on(
    connection: fabric.Connection,
    command: str,
    *,
    out: Sink,
    err: Sink,
    timeout_s: float,
    password: str | None = None,
) -> int:
    """Run what `on_lifeline` returned; return its exit status, or raise FleetError."""
    runner = Runner(connection, password)
    try:
        result = runner.run(
            command,
            out_stream=out,
            err_stream=err,
            in_stream=False,
            timeout=timeout_s,
            encoding="utf-8",
            warn=True,
        )
    except CommandTimedOut as error:
        raise FleetError(f"timed out after {timeout_s:g} s") from error
    except (ThreadException, OSError, EOFError, paramiko.SSHException) as error:
        log.debug("the connection broke", exc_info=error)
        raise FleetError("the connection broke while the command ran") from error
    if result.exited == ENDED_WITHOUT_STATUS:
        raise FleetError("the connection broke before the command ended")
    return int(result.exited)


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


Sinks = Callable[[str], tuple[Sink, Sink]]


@dataclass(frozen=True)
class Command:
    """What runs, and how. `line` is what the robot's login shell gets."""

    line: str
    timeout_s: float
    config: Path | None = None
    password: str | None = None
    accept_new: bool = False


class FleetRun:
    """One run on some robots, some at a time; `interrupted` when the person ended it before its end."""

    def __init__(
        self, command: Command, robots: Sequence[str], parallel: int, sinks: Sinks
    ) -> None:
        self._command = command
        self._robots = robots
        self._parallel = parallel
        self._sinks = sinks
        self._connections = SshConnections(accept_new=command.accept_new)
        self._waiting: SimpleQueue[str] = SimpleQueue()
        self._outcomes: dict[str, Outcome] = {}
        self.interrupted = False

    def run(self) -> list[Outcome]:
        """Run to the end, or until Ctrl-C, which ends the command on every robot; return one outcome a robot."""
        for robot in self._robots:
            self._waiting.put(robot)
        # Daemons: one that hangs in a dead network must not delay the end after Ctrl-C.
        threads = [
            Thread(target=self._work_off, daemon=True)
            for _ in range(min(self._parallel, len(self._robots)))
        ]
        try:
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
        except KeyboardInterrupt:
            self.interrupted = True
            self._connections.close_all()
            end_s = monotonic() + CLOSED_WITHIN_S
            for thread in filter(Thread.is_alive, threads):
                thread.join(max(0, end_s - monotonic()))
        finally:
            self._connections.close_all()
        return [
            self._outcomes.get(robot) or Outcome(robot, None, 0, "interrupted")
            for robot in self._robots
        ]

    def _work_off(self) -> None:
        with contextlib.suppress(Empty):
            while not self.interrupted:
                robot = self._waiting.get_nowait()
                self._outcomes[robot] = self._on(robot)

    def _on(self, robot: str) -> Outcome:
        start_s = monotonic()
        out, err = self._sinks(robot)
        status, problem = None, None
        try:
            with closing(out), closing(err):
                status = self._run_on(robot, out, err)
        except FleetError as error:
            problem = "interrupted" if self.interrupted else error.detail
        except Exception as error:
            # The border of one robot: the others go on.
            log.exception("robot %s", robot)
            problem = f"failed: {reason_in(error)} (see the log)"
        kept_out, kept_err = (sink if isinstance(sink, Captured) else None for sink in (out, err))
        return Outcome(robot, status, monotonic() - start_s, problem, kept_out, kept_err)

    def _run_on(self, robot: str, out: Sink, err: Sink) -> int:
        command = self._command
        target = fleet_ssh.resolve(robot, command.config)
        connection = self._connections.open(target)
        try:
            return run_on(
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
    chosen = fleet_ssh.choose(config, patterns)
    targets = [fleet_ssh.resolve(name, config) for name in chosen]
    rows = [
        (
            target.name,
            target.user,
            str(target.port),
            f"{target.jump.host}:{target.jump.port}" if target.jump else "-",
        )
        for target in targets
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
    chosen = fleet_ssh.choose(config, patterns)
    password = (
        click.prompt("sudo password", hide_input=True, err=True) if ask_sudo_password else None
    )
    sudo = sudo or ask_sudo_password
    remote_command = Command(
        line=on_lifeline(command, sudo=sudo, password=password is not None),
        timeout_s=timeout_s,
        config=config,
        password=password,
        accept_new=accept_new,
    )
    fleet_run = FleetRun(
        remote_command, chosen, parallel, captured if as_json else to_terminal(chosen)
    )
    outcomes = fleet_run.run()
    if as_json:
        print_json([as_dict(outcome) for outcome in sorted(outcomes, key=attrgetter("robot"))])
    else:
        print_summary(outcomes)
    if fleet_run.interrupted:
        sys.exit(INTERRUPTED)
    sys.exit(0 if all(outcome.ok for outcome in outcomes) else 1)


def print_summary(outcomes: Sequence[Outcome]) -> None:
    """Print a table where it disturbs no output of the robots, failures last: they are next to the prompt."""
    ordered = sorted(outcomes, key=lambda outcome: (not outcome.ok, outcome.robot))
    rows = [(outcome.robot, f"{outcome.seconds:.1f}", outcome.result) for outcome in ordered]
    good = sum(outcome.ok for outcome in outcomes)
    click.echo(err=True)
    print_table(("ROBOT", "SECONDS", "RESULT"), rows, err=True)
    click.echo(f"{good} of {len(outcomes)} robots: ok", err=True)
