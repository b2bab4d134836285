"""Opens TCP connections to one of a host's addresses, and peeks at the first bytes.

Names are resolved without waiting for a name service that does not answer. A connection is returned or closed; nothing
is read from it that somebody else may have to read. An option that this kernel, container or user may not set is left
out: a connection without it is slower, not worse.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import struct
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from ipaddress import ip_address
from itertools import chain, zip_longest
from typing import Any

from robotether_agent.describe_error import NAME_ADVICE, cause_of
from robotether_agent.net.happy_eyeballs import HappyEyeballs, after
from robotether_agent.problems import DetailError, NoAnswerError, ServerUnreachableError
from robotether_agent.tasks import readable, within

# Time limit for acknowledgements, after which the kernel closes a connection, even if its agent has
# ended.
USER_TIMEOUT_MS = 8000
# Maximum unsent size in the kernel; more would only make video older.
MEDIA_UNSENT_BYTES = 16 * 1024
# Numbers of linux/tcp.h that not every Python names.
TCP_INFO = 11
TCP_CONGESTION = 13
TCP_USER_TIMEOUT = 18
TCP_NOTSENT_LOWAT = 25
# struct tcp_info begins with bytes: the state, and third the time-outs since the last acknowledgement.
TCP_INFO_START = struct.Struct("=BxB")
ESTABLISHED = 1
# Time limit for the name service while an earlier address is known.
CACHED_TIMEOUT_S = 0.3
# Time limit for the name service without a known address.
RESOLVE_TIMEOUT_S = 3.0
THREADS = 4

Address = tuple[socket.AddressFamily, Any]
Resolve = Callable[[str, int], Sequence[Address]]
# Time limit for a TCP connection; a lost first packet is repeated after 1 s, a second loss is left
# to the next attempt.
CONNECT_TIMEOUT_S = 3.0
# Delay between attempts at two addresses, as RFC 8305 recommends.
STAGGER_S = 0.25
CHECK_NETWORK = "check this robot's network, and that the server's firewall allows this port"
CHECK_SERVER = "see that the server runs and has this port, and that no firewall refuses it"

log = logging.getLogger(__name__)


def prepare(connection: socket.socket) -> None:
    """Set what holds for every connection, best before it connects."""
    _set(connection, socket.TCP_NODELAY, 1)
    _set(connection, TCP_USER_TIMEOUT, USER_TIMEOUT_MS)


def prepare_for_video(connection: socket.socket) -> None:
    """Keep little unsent, and do not fill the path's queue."""
    _set(connection, TCP_NOTSENT_LOWAT, MEDIA_UNSENT_BYTES)
    _set(connection, TCP_CONGESTION, b"bbr")


def is_stuck(connection: socket.socket) -> bool:
    """Return whether what was sent waits for an acknowledgement for longer than the path ever took."""
    _, timeouts = _info(connection)
    return timeouts > 0


def is_established(connection: socket.socket) -> bool:
    """Return whether neither side has ended the connection."""
    state, _ = _info(connection)
    return state == ESTABLISHED


def _info(connection: socket.socket) -> tuple[int, int]:
    try:
        start = connection.getsockopt(socket.IPPROTO_TCP, TCP_INFO, TCP_INFO_START.size)
        state, timeouts = TCP_INFO_START.unpack(start)
    except (OSError, struct.error):
        return 0, 0
    return state, timeouts


def _set(connection: socket.socket, option: int, value: int | bytes) -> None:
    try:
        connection.setsockopt(socket.IPPROTO_TCP, option, value)
    except OSError as error:
        log.debug("TCP option %d is not set: %s", option, error)


def resolve(host: str, port: int) -> list[Address]:
    """Ask the system's resolver; raises OSError."""
    infos = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return [(family, address) for family, _, _, _, address in infos]


def _is_address(host: str) -> bool:
    """Return whether it is no name, for which somebody would have to be asked."""
    try:
        ip_address(host)
    except ValueError:
        return False
    return True


def interleaved(addresses: Sequence[Address]) -> list[Address]:
    """Return the addresses so that families take turns, the resolver's first choice first (RFC 8305)."""
    first = [item for item in addresses if item[0] == addresses[0][0]]
    others = [item for item in addresses if item[0] != addresses[0][0]]
    pairs = chain.from_iterable(zip_longest(first, others))
    return [item for item in pairs if item is not None]


class NameUnknownError(DetailError, OSError):
    """No address is known, for a reason in our own words."""


class Resolver:
    """Names and what they meant last."""

    def __init__(self, resolve_name: Resolve = resolve) -> None:
        self._resolve = resolve_name
        self._last: dict[tuple[str, int], list[Address]] = {}
        self._threads = threading.BoundedSemaphore(THREADS)

    async def addresses(self, host: str, port: int) -> list[Address]:
        """Return where `host` is now, or was last; raises NameUnknownError when it is not known."""
        if _is_address(host):
            return interleaved(self._resolve(host, port))
        last = self._last.get((host, port))
        try:
            wait_s = CACHED_TIMEOUT_S if last else RESOLVE_TIMEOUT_S
            return await within(wait_s, self._ask(host, port))
        except (asyncio.TimeoutError, OSError) as error:
            if last is None:
                why = _why_no_address(error)
                raise NameUnknownError(f"cannot find the address of {host}: {why}") from error
            log.debug("the name service does not answer for %s: trying its last address", host)
            return last

    async def _ask(self, host: str, port: int) -> list[Address]:
        if not self._threads.acquire(blocking=False):
            raise NameUnknownError("the name service has not answered earlier questions yet")
        loop = asyncio.get_running_loop()
        answer: asyncio.Future[list[Address]] = loop.create_future()

        def on_answer(result: list[Address] | OSError) -> None:
            if isinstance(result, OSError):
                if not answer.done():
                    answer.set_exception(result)
                return
            # An answer that comes too late for this question still helps the next one.
            self._last[host, port] = result
            if not answer.done():
                answer.set_result(result)

        asker = threading.Thread(target=self._run, args=(host, port, loop, on_answer), daemon=True)
        try:
            asker.start()
        except RuntimeError as error:
            # No memory, or too many threads: the other connections go on.
            self._threads.release()
            why = "this machine has no room for another thread (free, ulimit -u)"
            raise NameUnknownError(why) from error
        return await answer

    def _run(
        self,
        host: str,
        port: int,
        loop: asyncio.AbstractEventLoop,
        on_answer: Callable[[list[Address] | OSError], None],
    ) -> None:
        result: list[Address] | OSError
        try:
            result = interleaved(self._resolve(host, port))
        except OSError as error:
            result = error
        except UnicodeError as error:
            result = NameUnknownError(cause_of(error, RESOLVE_TIMEOUT_S).sentence)
        finally:
            self._threads.release()
        try:
            loop.call_soon_threadsafe(on_answer, result)
        except RuntimeError:
            log.debug("the name service answered for %s after the agent's end", host)


def _why_no_address(error: OSError | asyncio.TimeoutError) -> str:
    if isinstance(error, NameUnknownError):
        return str(error)
    if isinstance(error, asyncio.TimeoutError):
        return f"no answer from the name service in {RESOLVE_TIMEOUT_S:g} s"
    return cause_of(error, RESOLVE_TIMEOUT_S).sentence


async def connect(
    host: str, port: int, resolver: Resolver, name: str, advice: str = ""
) -> socket.socket:
    """Return a connection to `host` at whichever of its addresses answers first.

    Problems call it `name`, and give `advice` if it, and not this robot, may be at fault.
    """
    try:
        addresses = await resolver.addresses(host, port)
    except OSError as error:
        raise NoAnswerError(f"cannot reach {name}: {error}", advice=NAME_ADVICE) from error
    attempts = [partial(_connect, address, name, advice) for address in addresses]
    return await HappyEyeballs(attempts, pause=after(STAGGER_S), drop=socket.socket.close).winner()


async def _connect(address: Address, name: str, advice: str) -> socket.socket:
    family, where = address
    try:
        with ExitStack() as unless_connected:
            connection = socket.socket(family, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
            unless_connected.callback(connection.close)
            prepare(connection)
            connecting = asyncio.get_running_loop().sock_connect(connection, where)
            await within(CONNECT_TIMEOUT_S, connecting)
            unless_connected.pop_all()
            return connection
    except asyncio.TimeoutError as error:
        why = f"no answer in {CONNECT_TIMEOUT_S:g} s ({where[0]})"
        raise NoAnswerError(
            f"cannot reach {name}: {why}", advice=advice or CHECK_NETWORK
        ) from error
    except OSError as error:
        cause = cause_of(error, CONNECT_TIMEOUT_S)
        is_refused = isinstance(error, ConnectionRefusedError)
        raise (ServerUnreachableError if is_refused else NoAnswerError)(
            f"cannot reach {name}: {cause.sentence} ({where[0]})",
            advice=cause.advice or advice or (CHECK_SERVER if is_refused else CHECK_NETWORK),
        ) from error


async def peek(connection: socket.socket, is_enough: Callable[[bytes], bool], limit: int) -> bytes:
    """Return what has come so far, and leave it there, once it is enough or `limit` bytes.

    Raises ConnectionError when the other side ends the connection before.
    """
    seen = b""
    try:
        while True:
            # Readable then means: more than what was seen already, or the end.
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT, len(seen) + 1)
            await readable(connection)
            now = connection.recv(limit, socket.MSG_PEEK | socket.MSG_DONTWAIT)
            if len(now) == len(seen):
                raise ConnectionResetError("the connection was closed")
            seen = now
            if is_enough(seen) or len(seen) >= limit:
                return seen
    finally:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT, 1)
