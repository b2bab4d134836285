"""Runs one command on one robot with fabric, and ends it there when the connection ends.

sshd alone leaves a command running whose client has gone. So a small watcher beside the command reads standard input,
which stays open until then, and ends the process group when it closes; that works for what sudo started too.
"""

import shlex
from typing import IO

import fabric
import paramiko
from fabric.runners import Remote
from invoke.exceptions import CommandTimedOut, ThreadException

from robotether_server.cli.fleet.output import Sink
from robotether_server.cli.fleet.problems import CommandCut

POLL_S = 0.05

# One line, because some login shells take no line break between quotes. $1 is the command.
LIFELINE = (
    "exec 3<&0 </dev/null; "
    "{ while read -r _ <&3; do :; done; kill -TERM 0; } >/dev/null 2>&1 & "
    '"${SHELL:-/bin/sh}" -c "$1" 3<&-; status=$?; kill "$!" 2>/dev/null; exit "$status"'
)
ENDED_WITHOUT_STATUS = -1


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
        """Say whether the timer ended the command; invoke asks whether its thread has ended, which may be too soon."""
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
        raise CommandCut(f"the link broke: {error}") from error
    if result.exited == ENDED_WITHOUT_STATUS:
        raise CommandCut("the link broke before the command had ended")
    return int(result.exited)
