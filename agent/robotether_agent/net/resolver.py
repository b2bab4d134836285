"""Turns the server's name into addresses, without waiting for a name service that does not answer.

Used for each connection anew, since another network may know other addresses. A look-up runs in a thread of its own,
which a resolver that lost its network can hold for many seconds: it never holds up the agent, its end, or the next
look-up. Until the answer comes, the addresses of the last answer are tried.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import threading
from collections.abc import Callable, Sequence
from itertools import chain, zip_longest
from typing import Any

from robotether_agent.tasks import within

# A name service that is there answers in less.
CACHED_TIMEOUT_S = 0.3
# Without a known address there is nothing else to do than to wait for the name service.
TIMEOUT_S = 3.0
THREADS = 4

Address = tuple[socket.AddressFamily, Any]
Resolve = Callable[[str, int], Sequence[Address]]

log = logging.getLogger(__name__)


def resolve(host: str, port: int) -> list[Address]:
    """Ask the system's resolver; raises OSError."""
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return [(family, address) for family, _, _, _, address in found]


def interleaved(addresses: Sequence[Address]) -> list[Address]:
    """Return the addresses so that families take turns, the resolver's first choice first (RFC 8305)."""
    first = [item for item in addresses if item[0] == addresses[0][0]]
    others = [item for item in addresses if item[0] != addresses[0][0]]
    pairs = chain.from_iterable(zip_longest(first, others))
    return [item for item in pairs if item is not None]


class Resolver:
    """Names and what they meant last."""

    def __init__(self, resolve_name: Resolve = resolve) -> None:
        self._resolve = resolve_name
        self._last: dict[tuple[str, int], list[Address]] = {}
        self._threads = threading.BoundedSemaphore(THREADS)

    async def addresses(self, host: str, port: int) -> list[Address]:
        """Return where `host` is now, or was last; raises OSError when it is not known."""
        last = self._last.get((host, port))
        try:
            wait_s = CACHED_TIMEOUT_S if last else TIMEOUT_S
            return await within(wait_s, self._ask(host, port))
        except (asyncio.TimeoutError, OSError) as error:
            if last is None:
                why = str(error) or f"no answer from the name service in {TIMEOUT_S:g} s"
                raise OSError(f"cannot find the address of {host}: {why}") from error
            log.debug("the name service does not answer for %s: trying its last address", host)
            return last

    async def _ask(self, host: str, port: int) -> list[Address]:
        if not self._threads.acquire(blocking=False):
            raise OSError("the name service has not answered earlier questions yet")
        loop = asyncio.get_running_loop()
        answer: asyncio.Future[list[Address]] = loop.create_future()

        def on_answer(found: list[Address] | OSError) -> None:
            if isinstance(found, OSError):
                if not answer.done():
                    answer.set_exception(found)
                return
            # An answer that comes too late for this question still helps the next one.
            self._last[host, port] = found
            if not answer.done():
                answer.set_result(found)

        threading.Thread(target=self._run, args=(host, port, loop, on_answer), daemon=True).start()
        return await answer

    def _run(
        self,
        host: str,
        port: int,
        loop: asyncio.AbstractEventLoop,
        on_answer: Callable[[list[Address] | OSError], None],
    ) -> None:
        found: list[Address] | OSError
        try:
            found = interleaved(self._resolve(host, port))
        except OSError as error:
            found = error
        except UnicodeError as error:
            found = OSError(str(error))
        finally:
            self._threads.release()
        try:
            loop.call_soon_threadsafe(on_answer, found)
        except RuntimeError:
            log.debug("the name service answered for %s after the agent's end", host)
