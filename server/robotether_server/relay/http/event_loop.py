"""The relay's event loop: uvloop's, which must never close a connection that it does not own, and never hang.

`main` runs everything in it.
"""

from __future__ import annotations

import asyncio
import faulthandler
import gc
import logging
import resource
import socket
import sys
from collections.abc import Awaitable, Coroutine
from typing import Any

import uvloop

log = logging.getLogger(__name__)


class EventLoop(uvloop.Loop):
    """uvloop's, with one defect mended.

    When a connection over an open socket fails, uvloop 0.23 closes the file descriptor, and the socket does not know.
    It would close the number once more when it is collected, which may be that of a robot's or a driver's connection by
    then (https://github.com/MagicStack/uvloop/issues/738). aiohttp connects that way.
    """

    async def create_connection(
        self, *args: Any, sock: socket.socket | None = None, **options: Any
    ) -> Any:
        """Connect as usual; a `sock` with which that failed has no file descriptor any more."""
        try:
            return await super().create_connection(*args, sock=sock, **options)
        except BaseException:
            if sock is not None:
                sock.detach()
            raise


# Time limit for a turn of the loop. A busy machine makes it late by a second or two; every driver's connection has
# ended long before this.
MAX_LATENESS_S = 10.0
REARM_EVERY_S = 1.0
# Time limit for a thread that reads the database before the loop has its turn; Python's own is 5 ms.
SWITCH_AFTER_S = 0.0005
# Maximum number of messages before yielding to the event loop; a socket with a backlog would never
# yield.
MESSAGES_A_TURN = 64


# Maximum rate of large messages to all clients together, in bytes a second. It is below what nginx passes on: nginx
# reads a connection until nothing waits there, and serves no other one meanwhile.
LARGE_BYTES_PER_S = 64 * 1024 * 1024
# Size of the pieces in which a large message is sent.
PIECE_BYTES = 64 * 1024


async def next_turn(count: int) -> int:
    """Count a message that is about to be read; let everybody else go first now and then."""
    if count >= MESSAGES_A_TURN:
        await asyncio.sleep(0)
        return 1
    return count + 1


class PieceTurns:
    """Whose turn it is to send a piece of a large message; between two of them all small messages go."""

    def __init__(self) -> None:
        self._next_s = 0.0

    async def next(self) -> None:
        """Wait for a turn; the one that waits longest is next."""
        now_s = asyncio.get_running_loop().time()
        turn_s = max(now_s, self._next_s)
        self._next_s = turn_s + PIECE_BYTES / LARGE_BYTES_PER_S
        await asyncio.sleep(turn_s - now_s)


async def watched(work: Awaitable[None], max_lateness_s: float = MAX_LATENESS_S) -> None:
    """Do the work; once the loop is too late, end the process, for Docker to start it again.

    What each thread was at goes to stderr. The timer needs no Python, so that nothing that hangs holds it up.
    """
    rearming = asyncio.create_task(_rearm(max_lateness_s))
    try:
        await work
    finally:
        rearming.cancel()
        faulthandler.cancel_dump_traceback_later()


async def _rearm(max_lateness_s: float) -> None:
    while True:
        faulthandler.dump_traceback_later(max_lateness_s, exit=True)
        await asyncio.sleep(REARM_EVERY_S)


def prepare_process() -> None:
    """Let nothing but work hold up this process's loop, and let it have as many open files as it may.

    Docker 29 begins with 1024, and a fleet has more connections.
    """
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    # Else each full garbage collection visits all modules, and holds up every command for tens of ms.
    gc.freeze()
    # uvloop asks for its turn at each callback, of which a message takes several.
    sys.setswitchinterval(SWITCH_AFTER_S)


def start_task(name: str, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
    """Start a part that runs for ever; its failure is logged, as nobody awaits it before the relay stops."""
    task = asyncio.create_task(work, name=name)
    task.add_done_callback(_report_failure)
    return task


def _report_failure(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (problem := task.exception()) is not None:
        log.critical("task %s failed; restart the relay", task.get_name(), exc_info=problem)
