"""One SSH connection to the server: OpenSSH's client as a child process, on a TCP connection of ours.

Its stdin and stdout carry the session's lines; its control socket takes remote forwards while it runs.
Opened by a connection. Never leaves a child, a control socket or a connection behind, whatever fails.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
from asyncio.subprocess import DEVNULL, PIPE, Process
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Literal

from robotether_common.session import MAX_LINE_BYTES, Kind

from robotether_agent.net.server_dialer import ServerDialer, SshAddress
from robotether_agent.net.tcp import prepare_for_video
from robotether_agent.problems import AgentError, ForwardFailedError, LinkLostError, SshMissingError
from robotether_agent.tasks import within
from robotether_agent.tunnel.openssh import (
    Forward,
    SshFiles,
    child_environment,
    connect_command,
    control_command,
    stderr_with,
    why_ended,
    why_no_forward,
    why_not_connected,
)

MAX_STDERR_BYTES = 8 * 1024
CONTROL_TIMEOUT_S = 10.0
# Time limit for ending a connection; systemd and the next connection wait for it.
END_TIMEOUT_S = 1.5

log = logging.getLogger(__name__)


class Tunnel:
    """A running SSH client; `lines_in` and `lines_out` are the session's two directions.

    `socket` is the TCP connection under it, to look at and never to use.
    """

    def __init__(
        self,
        process: Process,
        target: SshAddress,
        files: SshFiles,
        connection: socket.socket,
        stderr: tuple[asyncio.StreamReader, asyncio.StreamWriter],
    ) -> None:
        if process.stdin is None or process.stdout is None:
            raise ValueError("the SSH client must run with two pipes")
        self.lines_in = process.stdout
        self.lines_out = process.stdin
        self.socket = connection
        self._process = process
        self._target = target
        self._files = files
        self._stderr = b""
        words, self._stderr_end = stderr
        self._listener = asyncio.ensure_future(self._listen(words))

    @classmethod
    async def open(cls, target: SshAddress, files: SshFiles, kind: Kind) -> Tunnel:
        """Start a client; whether it logs in shows when it sends lines or ends."""
        with ExitStack() as unless_open:
            connection = await (target.dialer or ServerDialer()).open(target)
            unless_open.callback(connection.close)
            if kind == "media":
                prepare_for_video(connection)
            if _exists(files.control):
                await _remove_stale(files.control)
            ours, clients = stderr_with(connection)
            unless_open.callback(ours.close)
            with clients:
                command = connect_command(target, files, kind)
                process = await _start(command, PIPE, clients.fileno())
            unless_open.callback(_signal, process, signal.SIGKILL)
            stderr = await asyncio.open_connection(sock=ours)
            unless_open.pop_all()
            return cls(process, target, files, connection, stderr)

    @property
    def is_logged_in(self) -> bool:
        """Whether the server has accepted the key: only then the client makes its control socket."""
        return _exists(self._files.control)

    async def add(self, forward: Forward) -> None:
        """Open `forward` on the live connection."""
        await self._control("forward", forward)

    async def cancel(self, forward: Forward) -> None:
        """Close `forward` on the live connection."""
        await self._control("cancel", forward)

    def on_connected(self) -> None:
        """Forget what was printed during the log-in, such as a banner: it is not why the connection ends."""
        self._stderr = b""

    async def why_ended(self, *, was_connected: bool) -> AgentError:
        """Wait shortly for the client's end and its last words, and return what they mean."""
        await asyncio.wait({self._listener}, timeout=END_TIMEOUT_S)
        try:
            status = await within(END_TIMEOUT_S, self._process.wait())
        except asyncio.TimeoutError:
            status = None
        words = self._stderr.decode(errors="replace").splitlines()
        if was_connected or status is None:
            return why_ended(words, status, self._target)
        return why_not_connected(words, status, self._target, self._files)

    async def close(self) -> None:
        """End the client within a bounded time, and remove what it leaves."""
        try:
            await _end(self._process)
        finally:
            self._listener.cancel()
            self._stderr_end.close()
            self.socket.close()
            _remove(self._files.control)

    async def _control(self, action: Literal["forward", "cancel"], forward: Forward) -> None:
        command = control_command(self._files.control, action, forward)
        status, words = await _run(command)
        if status is None:
            raise ForwardFailedError(
                f"cannot {action} {forward.spec}: no answer in {CONTROL_TIMEOUT_S:g} s"
            )
        if status != 0:
            raise why_no_forward(words, forward, action)

    async def _listen(self, stderr: asyncio.StreamReader) -> None:
        while chunk := await _read(stderr):
            log.debug("ssh %s: %s", self._target, chunk.decode(errors="replace").rstrip())
            self._stderr = (self._stderr + chunk)[-MAX_STDERR_BYTES:]


async def _read(stderr: asyncio.StreamReader) -> bytes:
    try:
        return await stderr.read(4096)
    except ConnectionError:
        # A client that ends while something is under way to it resets its stderr, for that is a socket.
        return b""


async def _remove_stale(control: Path) -> None:
    """End a client that an agent left which was killed, and remove its control socket."""
    await _run(control_command(control, "exit"), timeout_s=END_TIMEOUT_S)
    _remove(control)


def _exists(control: Path) -> bool:
    return control.exists()


def _remove(control: Path) -> None:
    control.unlink(missing_ok=True)


async def _start(command: list[str], stdin: int, stderr: int = PIPE) -> Process:
    try:
        return await asyncio.create_subprocess_exec(
            *command,
            stdin=stdin,
            stdout=PIPE,
            stderr=stderr,
            limit=MAX_LINE_BYTES,
            env=child_environment(),
            # A Ctrl-C in the terminal is for the agent, which then ends its clients in order.
            start_new_session=True,
        )
    except FileNotFoundError as error:
        raise SshMissingError("cannot connect: there is no OpenSSH client (ssh)") from error
    except OSError as error:
        # No memory, or too many processes: the other connections go on.
        raise LinkLostError(f"cannot start OpenSSH's client: {error.strerror}") from error


async def _run(
    command: list[str], timeout_s: float = CONTROL_TIMEOUT_S
) -> tuple[int | None, list[str]]:
    """Return a short command's status and stderr; a status of None is a time-out."""
    process = await _start(command, stdin=DEVNULL)
    try:
        _, words = await within(timeout_s, process.communicate())
    except asyncio.TimeoutError:
        return None, []
    finally:
        await _end(process)
    return process.returncode, words.decode(errors="replace").splitlines()


async def _end(process: Process) -> None:
    """Ask `process` to end, and kill it if it does not, or if the wait is cut short."""
    try:
        for number in (signal.SIGTERM, signal.SIGKILL):
            if process.returncode is None:
                _signal(process, number)
                with suppress(asyncio.TimeoutError):
                    await within(END_TIMEOUT_S, process.wait())
    finally:
        if process.returncode is None:
            _signal(process, signal.SIGKILL)


def _signal(process: Process, number: signal.Signals) -> None:
    try:
        os.killpg(process.pid, number)
    except ProcessLookupError:
        log.debug("ssh %d has ended already", process.pid)
