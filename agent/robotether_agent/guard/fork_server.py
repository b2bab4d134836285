"""The process that forks the guards: it has imported all that a guard needs, and shares its memory with them.

Forked by the cli from the agent before its event loop runs, so the agent shares that memory, too; restarted as a
program by the supervisor when it has ended. It runs no event loop and no thread, for both are unsafe to fork. It must
never outlive the agent, whose end it sees as the end of their socket, and never end before: a signal to all processes
of the agent lets agent and guard stop the robot first.

A request is one packet, answered at once by one number: FORK with the guard's standard input and output, answered by
its process id or an error's negative number; WAIT with a process id, answered by RUNS or that guard's exit code, before
which the id is not used again; PING.
"""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import signal
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import NoReturn

from robotether_agent.own_programs import program_environment
from robotether_agent.problems import GuardDownError

FORK, WAIT, PING = b"fork", b"wait", b"ping"
MAX_PACKET_BYTES = 64
# Number that is no exit code. Pause before the question is repeated, doubled each time, and its maximum: a guard that
# has closed its output is about to end, and a disk that hangs keeps one that was killed.
RUNS, RUNS_PAUSE_S, MAX_RUNS_PAUSE_S = 256, 0.001, 0.05
# As `ps -o comm` shows them, instead of the agent's own name; the kernel keeps 15 characters.
SERVER_NAME, GUARD_NAME = "guard-forks", "robot-guard"
# Time limit for a program's first answer; a small computer that boots needs seconds to load Python.
START_S = 20.0
# Time limit for a guard: a robot that moves may wait for it.
ANSWER_S = 0.4
# Time limit for a sign of life, for which nobody waits: one that is only slow is better than none while Python starts.
SIGN_OF_LIFE_S = 1.0
# They end a guard, and not the server.
END_SIGNALS = (signal.SIGTERM, signal.SIGINT)

RunGuard = Callable[[], int]

log = logging.getLogger(__name__)


def fork_server_command(state_dir: Path, run_dir: Path, log_level: str) -> list[str]:
    """Return the command of a fork server of guards, by the Python that runs the agent."""
    arguments = ["--state-dir", str(state_dir), "--run-dir", str(run_dir), "--log-level", log_level]
    return [sys.executable, "-m", "robotether_agent.guard", "--fork-server", *arguments]


def serve(control: socket.socket, run_guard: RunGuard) -> NoReturn:
    """Do what the agent asks for, until it is gone; each guard is `run_guard`, which returns its exit code."""
    status = 1
    try:
        _set_name(SERVER_NAME)
        # Garbage collections of the guards leave alone what is there, else they would copy its pages.
        gc.freeze()
        # Not ignored: a guard would lose what it is sent before it is one.
        signal.pthread_sigmask(signal.SIG_BLOCK, END_SIGNALS)
        while True:
            packet, pipes, _, _ = socket.recv_fds(control, MAX_PACKET_BYTES, 2)
            if not packet:
                break
            control.send(b"%d" % _answer(control, packet, pipes, run_guard))
        status = 0
    except ConnectionError:
        # The agent is gone.
        status = 0
    except BaseException:
        log.exception("the fork server fails")
    finally:
        # Not sys.exit: what the agent has set up to be done at its end is not to be done here.
        os._exit(status)


def _answer(
    control: socket.socket, packet: bytes, pipes: Sequence[int], run_guard: RunGuard
) -> int:
    if packet.startswith(WAIT):
        pid, status = os.waitpid(int(packet[len(WAIT) :]), os.WNOHANG)
        return os.waitstatus_to_exitcode(status) if pid else RUNS
    if packet != FORK:
        return 0
    try:
        pid = os.fork()
    except OSError as error:
        return -(error.errno or 1)
    if pid == 0:
        control.close()
        _be_guard(pipes, run_guard)
    for pipe in pipes:
        os.close(pipe)
    return pid


def _be_guard(pipes: Sequence[int], run_guard: RunGuard) -> NoReturn:
    status = 1
    try:
        for end_signal in END_SIGNALS:
            signal.signal(end_signal, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, END_SIGNALS)
        _set_name(GUARD_NAME)
        for number, pipe in enumerate(pipes):
            os.dup2(pipe, number)
            os.close(pipe)
        status = run_guard()
    except BaseException:
        log.exception("stopped by an error in the guard itself")
    finally:
        os._exit(status)


def _set_name(name: str) -> None:
    with suppress(OSError):
        Path("/proc/self/comm").write_text(name, encoding="ascii")


class ForkServer:
    """The agent's end of a fork server."""

    def __init__(
        self, control: socket.socket, pid: int, reap: Callable[[], object], start_s: float
    ) -> None:
        control.setblocking(False)
        self.pid = pid
        self._control = control
        self._reap = reap
        self._start_s = start_s
        self._answers: deque[asyncio.Future[int]] = deque()
        self._is_gone = False

    @classmethod
    def fork(cls, run_guard: RunGuard) -> ForkServer:
        """Fork a server off this process, which must have neither an event loop that runs nor a thread."""
        ours, theirs = _socket_pair()
        # The agent's own, too.
        gc.freeze()
        pid = os.fork()
        if pid == 0:
            ours.close()
            # A Ctrl-C in the terminal is for the agent, which then lets the guard stop the robot.
            os.setsid()
            serve(theirs, run_guard)
        theirs.close()
        return cls(ours, pid, partial(os.waitpid, pid, 0), start_s=0.0)

    @classmethod
    def start(cls, command: Sequence[str]) -> ForkServer:
        """Start a server as a program with the socket as its standard input; raises GuardDownError without it."""
        with ExitStack() as unless_started:
            try:
                ours, theirs = _socket_pair()
                unless_started.callback(ours.close)
                with theirs:
                    process = subprocess.Popen(  # noqa: S603 - the agent's own program, no shell
                        command,
                        stdin=theirs.fileno(),
                        env=program_environment(os.environ),
                        start_new_session=True,
                    )
            except OSError as error:
                raise GuardDownError(f"cannot start the guard: {error.strerror}") from error
            unless_started.pop_all()
        return cls(ours, process.pid, process.wait, start_s=START_S)

    async def guard(self, stdin: int, stdout: int) -> int:
        """Fork a guard with these pipes, and return its process id; GuardDownError if that fails."""
        answer = await self._answered(self._ask(FORK, (stdin, stdout)), ANSWER_S)
        if answer < 0:
            raise GuardDownError(f"cannot start the guard: {os.strerror(-answer)}")
        return answer

    async def exit_code(self, pid: int) -> int:
        """Return a guard's exit code, as subprocess has it, once it has ended; ask once for each guard."""
        pause_s = RUNS_PAUSE_S
        while (code := await self._ask(WAIT + b"%d" % pid)) == RUNS:
            await asyncio.sleep(pause_s)
            pause_s = min(MAX_RUNS_PAUSE_S, 2 * pause_s)
        return code

    async def check(self) -> None:
        """Raise GuardDownError if it has ended or hangs."""
        await self._answered(self._ask(PING), SIGN_OF_LIFE_S)

    def kill(self) -> None:
        """End it at once; the guards that it has forked stay."""
        if not self._is_gone:
            os.kill(self.pid, signal.SIGKILL)

    def close(self) -> None:
        """End it, and wait until it has ended."""
        self.kill()
        self._on_end()

    async def _answered(self, answer: asyncio.Future[int], limit_s: float) -> int:
        await asyncio.wait({answer}, timeout=max(limit_s, self._start_s))
        if not answer.done():
            raise GuardDownError("the fork server hangs")
        return answer.result()

    def _ask(self, packet: bytes, pipes: Sequence[int] = ()) -> asyncio.Future[int]:
        answer: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        ignore_failure(answer)
        try:
            socket.send_fds(self._control, [packet], pipes)
        except OSError:
            answer.set_exception(GuardDownError("the fork server ended"))
        else:
            self._answers.append(answer)
            answer.get_loop().add_reader(self._control, self._on_answer)
        return answer

    def _on_answer(self) -> None:
        try:
            packet = self._control.recv(MAX_PACKET_BYTES)
        except BlockingIOError:
            return
        except OSError:
            packet = b""
        if not packet:
            self._on_end()
            return
        self._start_s = 0.0
        answer = self._answers.popleft()
        if not answer.done():
            answer.set_result(int(packet))

    def _on_end(self) -> None:
        if self._is_gone:
            return
        self._is_gone = True
        with suppress(RuntimeError):
            # It may never have been asked for anything, and there may be no loop any more.
            asyncio.get_running_loop().remove_reader(self._control)
        self._control.close()
        # It is about to end, if it has not ended yet: the kernel has closed its end of the socket.
        self._reap()
        for answer in self._answers:
            if not answer.done():
                answer.set_exception(GuardDownError("the fork server ended"))
        self._answers.clear()


def ignore_failure(future: asyncio.Future[int]) -> None:
    """Let it fail when nobody waits for it any more."""
    future.add_done_callback(lambda done: done.cancelled() or done.exception())


def _socket_pair() -> tuple[socket.socket, socket.socket]:
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
