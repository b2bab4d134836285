"""Runs one command on one robot with fabric, passes its output on, and ends it there when the connection ends.

sshd leaves a command running when its client disconnects. So a small watcher beside the command reads standard input
and ends the process group when it closes, including what sudo started. Output is passed on in whole lines, each with
its robot's name. Control characters are escaped: a robot must not control the operator's terminal.
"""

import shlex
from threading import Lock
from typing import IO, Protocol, TextIO

import fabric
import paramiko
from fabric.runners import Remote
from invoke.exceptions import CommandTimedOut, ThreadException

from robotether_server.cli.fleet.problems import CommandCut

MAX_LINE_LENGTH = 16 * 1024
MAX_CAPTURED_LENGTH = 1024 * 1024

_SHOWN = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160)) if chr(code) != "\t"}


POLL_S = 0.05
# One line, because some login shells take no line break between quotes. $1 is the command.
LIFELINE = (
    "exec 3<&0 </dev/null; "
    "{ while read -r _ <&3; do :; done; kill -TERM 0; } >/dev/null 2>&1 & "
    '"${SHELL:-/bin/sh}" -c "$1" 3<&-; status=$?; kill "$!" 2>/dev/null; exit "$status"'
)
ENDED_WITHOUT_STATUS = -1


class Sink(Protocol):
    """Where one output of one robot goes."""

    def write(self, text: str) -> None:
        """Process the next piece."""

    def close(self) -> None:
        """Take notice that there is no more."""


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
                self._to.write(f"{self._prefix}{line.removesuffix(chr(13)).translate(_SHOWN)}\n")
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
        """Tell whether the timer ended the command; invoke asks whether its thread has ended, which may be too soon."""
        return self._is_out_of_time

    def send_start_message(self, command: str) -> None:
        """Start the command; the first line is for sudo, or else for the watcher, which takes no notice."""
        super().send_start_message(command)
        if self._password is not None:
            self.channel.sendall(f"{self._password}\n".encode())

    def handle_stdout(self, buffer_: list[str], hide: bool, output: IO[str]) -> None:
        """Pass standard output on."""
        for text in self.read_proc_output(self.read_proc_stdout):
            output.write(text)

    def handle_stderr(self, buffer_: list[str], hide: bool, output: IO[str]) -> None:
        """Pass standard error on."""
        for text in self.read_proc_output(self.read_proc_stderr):
            output.write(text)


def run(
    connection: fabric.Connection,
    command: str,
    *,
    out: Sink,
    err: Sink,
    timeout_s: float,
    password: str | None = None,
) -> int:
    """Run what `on_lifeline` returned; return its exit status, or raise CommandCut."""
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
        raise CommandCut(f"timed out after {timeout_s:g} s") from error
    except (ThreadException, OSError, EOFError, paramiko.SSHException) as error:
        raise CommandCut(f"the connection broke: {error}") from error
    if result.exited == ENDED_WITHOUT_STATUS:
        raise CommandCut("the connection broke before the command ended")
    return int(result.exited)
