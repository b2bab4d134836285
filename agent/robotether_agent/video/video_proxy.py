"""The media forward's end on the robot: passes web_video_server's streams on as fast as the uplink allows.

Started by the agent, one for its whole life; the forward of `video_port` leads to its port:

    proxy = VideoProxy(settings.video_url, LocalService(port=frames.port, when="down"), Pacer())
    port = await proxy.start()                      # forward to 127.0.0.1:port in place of video_url
    proxy.use(tunnel.socket)                        # for each new media connection, before or after its forward
    proxy.hold()                                    # when that connection ends
    await proxy.close()

`use` takes a socket of the media SSH connection, a duplicate that stays the caller's, or None: then video is passed on
unpaced, as also on a kernel that reports too little. What does not fit into the uplink is not read from
web_video_server, which keeps one frame a viewer and drops those that come meanwhile: where they are made, before they
cost anything. (After each 0.5 s in which a viewer took nothing it queues one more: that is how it treats slow viewers.)
Of HTTP it knows the first words of a connection: `GET /robotether/` leads to the agent's own media service, any other
URL passes, unchanged and at once. Never keeps more than CHUNK bytes of a stream.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Literal
from urllib.parse import urlsplit

from robotether_common.topics import PATH as TOPICS_PATH

from robotether_agent.tasks import readable, within
from robotether_agent.video.pacer import Pacer

CHUNK = 16 * 1024
# Maximum number of streams; the server opens at most 64 per robot, 64 topics, and checks whether video works.
MAX_STREAMS = 160
BACKLOG = 64
# Size of the receive buffer from web_video_server: frames that wait in the kernel are old when they
# leave, and by default some MB would wait, since it grants 64 KB segments on loopback.
RECEIVE_BYTES = 16 * 1024
SEGMENT = 1448
SEND_BYTES = 32 * 1024
DIAL_TIMEOUT_S = 5.0
# First bytes of the agent's own paths, and time limit for the rest of a path that begins so.
LOCAL_PATHS = (b"GET /robotether/", b"HEAD /robotether/")
TOPICS = b"GET " + TOPICS_PATH.encode()
KNOWN_PATHS = (*LOCAL_PATHS, TOPICS)
KNOWN_PATH_BYTES = max(map(len, KNOWN_PATHS))
# Maximum size of what a topic sends in a second that does not count as bulk.
BULK_AFTER_BYTES = 8 * 1024
FIRST_WORDS_S = 5.0
# Time limit for data on the way when one side has ended.
LAST_S = 10.0

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LocalService:
    """The agent's own media service, and when it answers what else web_video_server would."""

    port: int
    when: Literal["never", "down", "always"] = "never"
    # Whether what it sends on a connection from this port waits while others send.
    yields: Callable[[int], bool] = lambda _: False


class VideoProxy:
    """A TCP port of the robot in front of the service at `upstream_url`, which names host and port."""

    def __init__(self, upstream_url: str, local: LocalService, pacer: Pacer) -> None:
        split = urlsplit(upstream_url)
        if split.hostname is None or split.port is None:
            raise ValueError(f"{upstream_url} has no host and port")
        self._upstream = (split.hostname, split.port)
        self._local = local
        self._pacer = pacer
        self._streams: set[asyncio.Task[None]] = set()
        self._listener: socket.socket | None = None
        self._acceptor: asyncio.Task[None] | None = None

    async def start(self) -> int:
        """Listen on 127.0.0.1, and return the port."""
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=BACKLOG)
        self._listener.setblocking(False)
        self._acceptor = asyncio.ensure_future(self._accept(self._listener))
        port: int = self._listener.getsockname()[1]
        return port

    def use(self, connection: socket.socket | None) -> None:
        """Pace by what the kernel knows of `connection` from now on."""
        self._pacer.use(connection)

    def hold(self) -> None:
        """Send nothing until the next `use`: the media connection ends."""
        self._pacer.hold()

    async def close(self) -> None:
        """End all streams and listen no more."""
        self._pacer.hold()
        tasks = [*self._streams, *([] if self._acceptor is None else [self._acceptor])]
        for task in tasks:
            task.cancel()
        try:
            await asyncio.gather(*tasks, return_exceptions=True)
        finally:
            if self._listener is not None:
                self._listener.close()

    async def _accept(self, listener: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                viewer, _ = await loop.sock_accept(listener)
            except OSError as error:
                # Too many open files, mostly: it passes, and the listener stays.
                log.warning("cannot accept a video connection: %s", error)
                await asyncio.sleep(1)
                continue
            if len(self._streams) >= MAX_STREAMS:
                log.warning("refused a video connection: %d are open", MAX_STREAMS)
                viewer.close()
                continue
            stream = asyncio.ensure_future(self._serve(viewer))
            self._streams.add(stream)
            stream.add_done_callback(self._streams.discard)

    async def _serve(self, viewer: socket.socket) -> None:
        with viewer:
            viewer.setblocking(False)
            try:
                first = await first_words(viewer)
                with await self._upstream_for(first) as upstream:
                    is_topic = first.startswith(TOPICS)
                    yields = partial(self._local.yields, upstream.getsockname()[1])
                    stream = Stream(viewer, upstream, self._pacer, is_topic=is_topic, yields=yields)
                    await stream.run(first)
            except OSError as error:
                # A viewer who left, or a web_video_server that does not run: health reports the latter.
                log.debug("a video connection ended: %r", error)
            except Exception:
                log.exception("a video connection failed")

    async def _upstream_for(self, first: bytes) -> socket.socket:
        """Connect to what answers a request of these first words."""
        here = ("127.0.0.1", self._local.port)
        if self._local.when == "always" or first.startswith(LOCAL_PATHS):
            return await self._dial(*here)
        try:
            return await self._dial(*self._upstream)
        except OSError:
            if self._local.when == "never":
                raise
            return await self._dial(*here)

    async def _dial(self, host: str, port: int) -> socket.socket:
        loop = asyncio.get_running_loop()
        infos = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        error: OSError = OSError(f"{host} has no address")
        for family, kind, protocol, _, address in infos:
            connection = socket.socket(family, kind, protocol)
            try:
                connection.setblocking(False)
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_MAXSEG, SEGMENT)
                await within(DIAL_TIMEOUT_S, loop.sock_connect(connection, address))
            except (OSError, asyncio.TimeoutError) as failed:
                connection.close()
                error = OSError(f"cannot reach {host} port {port}: {failed!r}")
            except BaseException:
                connection.close()
                raise
            else:
                return connection
        raise error


class Stream:
    """One connection in both directions: requests at once, answers as the pacer allows."""

    def __init__(
        self,
        viewer: socket.socket,
        upstream: socket.socket,
        pacer: Pacer,
        *,
        is_topic: bool,
        yields: Callable[[], bool],
    ) -> None:
        viewer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
        viewer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        upstream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._viewer = viewer
        self._upstream = upstream
        self._pacer = pacer
        self._loop = asyncio.get_running_loop()
        self._poured = 0
        self._is_topic = is_topic
        self._yields = yields
        # How much had been poured when the last second began, and when that was.
        self._second = (0, self._loop.time())

    async def run(self, first: bytes) -> None:
        """Pass bytes on, after those that were read already, until both directions have ended, or one fails."""
        ask = asyncio.ensure_future(self._ask(first))
        pour = asyncio.ensure_future(self._pour())
        try:
            done, _ = await asyncio.wait({ask, pour}, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
            await (asyncio.wait({ask}, timeout=LAST_S) if pour.done() else self._drain(pour))
        finally:
            for task in (ask, pour):
                task.cancel()
            await asyncio.gather(ask, pour, return_exceptions=True)

    async def _ask(self, first: bytes) -> None:
        await self._loop.sock_sendall(self._upstream, first)
        while data := await self._loop.sock_recv(self._viewer, CHUNK):
            await self._loop.sock_sendall(self._upstream, data)
        end_writing(self._upstream)

    async def _pour(self) -> None:
        while data := await self._loop.sock_recv(self._upstream, CHUNK):
            rest = memoryview(data)
            while rest:
                granted = await self._pacer.acquire(len(rest), is_bulk=self._is_bulk(len(rest)))
                await self._loop.sock_sendall(self._viewer, rest[:granted])
                rest = rest[granted:]
                self._poured += granted
        end_writing(self._viewer)

    def _is_bulk(self, waiting: int) -> bool:
        """Whether others overtake it: a camera's second copy, or a topic that sends more than a small one does.

        What waits counts: on a full line each of many large topics gets no more through than a small one.
        """
        now_s = self._loop.time()
        if now_s - self._second[1] > 1.0:
            self._second = (self._poured, now_s)
        sent = self._poured + waiting - self._second[0]
        return (self._is_topic and sent > BULK_AFTER_BYTES) or self._yields()

    async def _drain(self, pour: asyncio.Task[None]) -> None:
        """Go on for a viewer who asks no more, while it gets something; nothing else shows that it left."""
        before = -1
        while not pour.done() and self._poured != before:
            before = self._poured
            await asyncio.wait({pour}, timeout=LAST_S)
        if pour.done():
            pour.result()


async def first_words(viewer: socket.socket) -> bytes:
    """Read until it is clear whether this is the agent's own: mostly once, and never more than that takes.

    Returns what there is when the viewer says no more, be it for FIRST_WORDS_S.
    """
    loop = asyncio.get_running_loop()
    deadline_s = loop.time() + FIRST_WORDS_S
    words = b""
    while any(path.startswith(words) and path != words for path in KNOWN_PATHS):
        try:
            await within(deadline_s - loop.time(), readable(viewer))
        except asyncio.TimeoutError:
            return words
        # Not sock_recv: when its time is over just when something comes, that would be lost.
        more = viewer.recv(KNOWN_PATH_BYTES - len(words))
        if not more:
            return words
        words += more
    return words


def end_writing(connection: socket.socket) -> None:
    """Signal to the other end that no more comes, and go on reading."""
    with suppress(OSError):
        connection.shutdown(socket.SHUT_WR)
