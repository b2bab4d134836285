"""A robot's end as the relay sees it: a session over TCP, and servers on its forwarded ports.

Unit tests of the relay start it. Its misbehaviours have names:

    port_taken     keeps its ports when its session ends
    slow_reader    its rosbridge reads nothing
    no_rosbridge   its ports accept and close, as a tunnel to nothing does

These have the guard switched off, as `guard_off` does, which behaves. With a guard in front:

    guarded        behaves
    guard_refuses  answers 409 to every driver
    guard_says_why answers 409 with a reason
    guard_quiet    reports nothing by itself
    disk_full      answers 507 to every driver
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import struct
import time
from typing import Any, Literal, get_args

from aiohttp import WSMsgType, web

FramesMode = Literal["behaves", "no_clock_sync", "no_service", "any_page", "full"]
STATUSES = {"no_service": 404, "any_page": 200, "full": 503}
HEADER = struct.Struct("!BBHId")
WAIT_S = 30.0


class FakeFrames:
    """The frames service on a robot's video port: a picture goes out for a credit, and then the newest.

    Modes: `behaves`; `no_clock_sync` answers none; `no_service` answers 404, as web_video_server does; `any_page`
    200, as a server of plain MJPEG may; `full` 503, as an agent with too many cameras open does.
    """

    def __init__(self, clock_ms: Any, mode: FramesMode = "behaves") -> None:
        self.mode = mode
        self.clock_ms = clock_ms
        self.topics: list[str] = []
        self.texts: list[dict[str, Any]] = []
        self.connections: set[web.WebSocketResponse] = set()
        self.credits: dict[web.WebSocketResponse, int] = {}
        self.sequence = 0
        self._newest: tuple[int, bytes] | None = None
        self._changed = asyncio.Event()

    async def serve(self, request: web.Request) -> web.StreamResponse:
        if self.mode in STATUSES:
            return web.Response(status=STATUSES[self.mode])
        socket = web.WebSocketResponse(compress=False, max_msg_size=4096, timeout=0.1)
        await socket.prepare(request)
        self.topics.append(request.query["topic"])
        self.connections.add(socket)
        self.credits[socket] = 0
        try:
            async for message in socket:
                if message.type is WSMsgType.TEXT:
                    await self._handle(socket, json.loads(message.data))
        finally:
            self.connections.discard(socket)
            self._changed.set()
        return socket

    async def show(
        self,
        jpeg: bytes,
        *,
        quality: int = 70,
        codec: int = 1,
        is_key: bool = False,
    ) -> int:
        """Have a picture taken now; it goes out where there is credit. Return its number."""
        self.sequence += 1
        flags = 1 | 2 * is_key
        header = HEADER.pack(codec, flags, quality, self.sequence, self.clock_ms())
        self._newest = (self.sequence, header + jpeg)
        for socket in list(self.connections):
            await self._send(socket)
        return self.sequence

    async def send_status(self, **status: object) -> None:
        await self.send_text({"op": "status", "detail": "", **status})

    async def send_text(self, message: object) -> None:
        for socket in list(self.connections):
            await socket.send_str(json.dumps(message))

    async def send_bytes(self, data: bytes) -> None:
        for socket in list(self.connections):
            await socket.send_bytes(data)

    async def wait_for(self, op: str, **members: object) -> dict[str, Any]:
        async with asyncio.timeout(WAIT_S):
            while True:
                for text in self.texts:
                    if text["op"] == op and members.items() <= text.items():
                        return text
                self._changed.clear()
                await self._changed.wait()

    def of(self, op: str) -> list[dict[str, Any]]:
        return [text for text in self.texts if text["op"] == op]

    async def cut(self) -> None:
        for socket in list(self.connections):
            transport = socket._req.transport if socket._req is not None else None
            if transport is not None:
                transport.abort()

    async def _handle(self, socket: web.WebSocketResponse, message: dict[str, Any]) -> None:
        self.texts.append(message)
        self._changed.set()
        if message["op"] == "clock_sync" and self.mode != "no_clock_sync":
            answer = {"op": "clock_sync", "t_ms": message["t_ms"], "sender_ms": self.clock_ms()}
            await socket.send_str(json.dumps(answer))
        elif message["op"] == "credit":
            self.credits[socket] += message["frames"]
            assert self.credits[socket] <= 8, "the relay has more than eight credits open"
            await self._send(socket)

    async def _send(self, socket: web.WebSocketResponse) -> None:
        if self._newest is None or not self.credits[socket]:
            return
        (_, frame), self._newest = self._newest, None
        self.credits[socket] -= 1
        with contextlib.suppress(ConnectionError):
            await socket.send_bytes(frame)


Unguarded = Literal["guard_off", "port_taken", "slow_reader", "no_rosbridge"]
Guarded = Literal["guarded", "guard_refuses", "guard_says_why", "guard_quiet", "disk_full"]
Mode = Unguarded | Guarded
GUARDED = get_args(Guarded)
# How far the robot's clock is from this machine's.
AHEAD_MS = 1e6

HOST = "127.0.0.1"
# Of the one key that all robots of the tests have; `openssh_server` names it too.
FINGERPRINT = "SHA256:of the tests"
FLOOD_MESSAGE = b"x" * 65536
JPEG = b"\xff\xd8" + b"picture" * 100 + b"\xff\xd9"


class RobotSession:
    def __init__(
        self,
        robot_id: int,
        *,
        kind: str,
        session_key: str,
        silent: bool = False,
        fingerprint: str = FINGERPRINT,
        ports: tuple[int, ...] = (),
    ) -> None:
        self.robot_id = robot_id
        self.fingerprint = fingerprint
        self.ports = ports
        self.kind = kind
        self.session_key = session_key
        self.silent = silent
        self.lines: list[dict[str, Any]] = []
        self.configs: list[dict[str, Any]] = []
        self.checked: list[dict[str, Any]] = []
        self.bye: dict[str, Any] | None = None
        self.leases: list[dict[str, Any]] = []
        self.orders: list[dict[str, Any]] = []
        self.stopped = False
        self.stopped_by = ""
        self.fence = 0
        self.answers_orders = True
        self.pings = 0
        self.pongs: list[dict[str, Any]] = []
        self.configured = asyncio.Event()
        self.closed = asyncio.Event()
        self._reader: asyncio.StreamReader
        self._writer: asyncio.StreamWriter
        self._task: asyncio.Task[None]
        self._heartbeat: asyncio.Task[None] | None = None

    async def connect(self, port: int) -> None:
        self._reader, self._writer = await asyncio.open_connection(HOST, port)
        self.send(
            type="preface",
            kind=self.kind,
            robot_id=self.robot_id,
            fingerprint=self.fingerprint,
            ports=list(self.ports),
            address="198.51.100.7",
            port=51234,
            session_key=self.session_key,
        )
        self._task = asyncio.create_task(self._read())

    async def wait_configured(self) -> None:
        """Wait for the configuration, which the relay holds back while the robot's port is taken."""
        try:
            await asyncio.wait_for(self.configured.wait(), WAIT_S)
        except TimeoutError as error:
            raise AssertionError(
                f"no configuration of the {self.kind} in {WAIT_S:g} s: it got {self.lines}; see with "
                "'ss -tlnp' whether another program listens on the robot's ports"
            ) from error

    def send(self, **fields: object) -> None:
        self.send_raw(json.dumps(fields).encode() + b"\n")

    def send_raw(self, data: bytes) -> None:
        self._writer.write(data)

    async def _read(self) -> None:
        try:
            while line := await self._reader.readline():
                self._handle(json.loads(line))
        except ConnectionError:
            pass
        finally:
            if self._heartbeat is not None:
                self._heartbeat.cancel()
            self.closed.set()
            self._writer.close()

    async def _ping(self, every_s: float) -> None:
        while True:
            self.send(type="ping", seq=0, t_ms=self.clock_ms())
            await asyncio.sleep(every_s)

    def _handle(self, message: dict[str, Any]) -> None:
        self.lines.append(message)
        if message["type"] == "config":
            self.configs.append(message)
            if self.kind != "session" and not self.silent and self._heartbeat is None:
                self._heartbeat = asyncio.create_task(self._ping(message["heartbeat_s"]))
            self.configured.set()
        elif message["type"] == "ping":
            self._answer(message["seq"])
        elif message["type"] == "lease":
            self.leases.append(message)
        elif message["type"] in {"stop", "release"}:
            self._obey(message)
        elif message["type"] == "pong":
            self.pongs.append(message)
        elif message["type"] == "checked":
            self.checked.append(message)
        elif message["type"] == "bye":
            self.bye = message

    def _answer(self, seq: int) -> None:
        self.pings += 1
        if not self.silent:
            self.send(type="pong", seq=seq)
            self.send(type="ping", seq=seq, t_ms=self.clock_ms())

    def _obey(self, order: dict[str, Any]) -> None:
        self.orders.append(order)
        if self.answers_orders:
            self.stopped = order["type"] == "stop"
            self.stopped_by = order["by"]
            self.send_guard_status(answers=order["id"])

    def send_guard_status(
        self, answers: str | None = None, fence: int | None = None, **refused: int
    ) -> None:
        """Say how the guard is, the newest number it knows, and what it has refused since its start."""
        self.fence = self.fence if fence is None else fence
        self.send(
            type="guard",
            state="ready",
            stopped=self.stopped,
            by=self.stopped_by,
            moving=False,
            fence=self.fence,
            answers=answers,
            refused={"old": 0, "fence": 0, "stopped": 0, "shape": 0, "held": 0} | refused,
        )

    @staticmethod
    def clock_ms() -> float:
        return time.monotonic() * 1000 + AHEAD_MS

    async def close(self) -> None:
        self._writer.transport.abort()
        await self._task


class FakeRobot:
    def __init__(self, robot_id: int, session_key: str, mode: Mode = "guard_off") -> None:
        self.mode = mode
        self.session = RobotSession(robot_id, kind="session", session_key=session_key)
        self.media = RobotSession(robot_id, kind="media", session_key=session_key)
        # 0: its agent is older than cells.
        self.epoch = 0
        self.received: list[str | bytes] = []
        self.video_requests: list[dict[str, Any]] = []
        self.clients: set[web.WebSocketResponse] = set()
        self.clients_ever = 0
        # Connections that each carry a topic, and whether there may be any.
        self.topics: list[web.WebSocketResponse] = []
        self.has_topics = True
        # What it says of its line; an agent before this answers with something else.
        self.line_answer = "no such page"
        self.repeats = False
        self.handshakes: list[dict[str, str]] = []
        self._connected = asyncio.Event()
        self.raw_answer: list[bytes] = []
        # It has no frames service unless a test says otherwise.
        self.frames = FakeFrames(self.session.clock_ms, "no_service")
        self._runners: list[web.AppRunner] = []
        self._closer: asyncio.Server | None = None
        self._watch: asyncio.Task[None] | None = None

    async def start(self, session_port: int) -> None:
        await self.session.connect(session_port)
        await self.session.wait_configured()
        await self._open_rosbridge(self.session.configs[0]["ros_port"])
        await self.media.connect(session_port)
        await self.media.wait_configured()
        await self._listen(self._video_app(), self.media.configs[0]["video_port"])
        self._say_hello()
        self.session.send(type="health", ros="ok", video="ok", detail="", ros_exposed=False)
        self._watch = asyncio.create_task(self._close_ports_with_session())

    def _say_hello(self) -> None:
        session, guard = self.session, "on" if self.mode in GUARDED else "off"
        epoch = {"epoch": self.epoch} if self.epoch else {}
        session.send(type="hello", guard=guard, hostname="turtle", agent_version="0.1.0", **epoch)
        if self.mode in GUARDED:
            session.send(type="ping", seq=0, t_ms=session.clock_ms())
            if self.mode != "guard_quiet":
                session.send_guard_status()

    async def send_to_clients(self, data: bytes) -> None:
        for client in list(self.clients):
            with contextlib.suppress(ConnectionError):
                await client.send_frame(data, WSMsgType.TEXT)

    async def connections(self, count: int) -> list[dict[str, str]]:
        async with asyncio.timeout(WAIT_S):
            while len(self.handshakes) < count:
                self._connected.clear()
                await self._connected.wait()
        return self.handshakes

    async def stop(self) -> None:
        for session in (self.session, self.media):
            if hasattr(session, "_task"):
                await session.close()
        if self._watch is not None:
            # Not cancelled: the session may have ended before, and then this is closing ports that nobody else knows.
            await self._watch
        await self._close_ports()

    async def _close_ports_with_session(self) -> None:
        await self.session.closed.wait()
        if self.mode != "port_taken":
            await self._close_ports()

    async def _close_ports(self) -> None:
        if self._closer is not None:
            self._closer.close()
        runners, self._runners = self._runners, []
        for runner in runners:
            await runner.cleanup()

    async def _open_rosbridge(self, port: int) -> None:
        if self.mode == "no_rosbridge":
            self._closer = await asyncio.start_server(lambda _r, w: w.close(), HOST, port)
            return
        app = web.Application()
        app.router.add_get("/", self._rosbridge)
        await self._listen(app, port)

    async def _listen(self, app: web.Application, port: int) -> None:
        runner = web.AppRunner(
            app, access_log=None, handler_cancellation=True, shutdown_timeout=0.1
        )
        await runner.setup()
        await web.TCPSite(runner, HOST, port, reuse_address=True).start()
        self._runners.append(runner)

    async def _rosbridge(self, request: web.Request) -> web.WebSocketResponse:
        self.handshakes.append(dict(request.headers))
        self._connected.set()
        if self.mode in GUARDED and (status := self._refusal(request)) is not None:
            says_why = self.mode == "guard_says_why"
            reason = {"Robotether-Reason": "the robot is stopped"} if says_why else {}
            return web.Response(status=status, headers=reason)  # type: ignore[return-value]  # no upgrade
        client = web.WebSocketResponse(compress=False, max_msg_size=0, timeout=0.1)
        await client.prepare(request)
        assert request.transport is not None
        self.clients.add(client)
        self.clients_ever += 1
        try:
            if self.mode == "slow_reader":
                request.transport.pause_reading()
                await asyncio.Event().wait()
            else:
                await self._echo(client)
        finally:
            self.clients.discard(client)
        return client

    def _refusal(self, request: web.Request) -> int | None:
        session, headers = self.session, request.headers
        if headers.get("Robotether-Key") != session.configs[-1]["guard"]["key"]:
            return 403
        if headers["Robotether-Mode"] != "drive":
            return None
        if self.mode == "disk_full":
            return 507
        newest = max(session.leases[-1]["fence"], session.fence)
        refused = self.mode in ("guard_refuses", "guard_says_why") or session.stopped
        return 409 if refused or int(headers["Robotether-Fence"]) < newest else None

    async def _echo(self, client: web.WebSocketResponse) -> None:
        async for message in client:
            self.received.append(message.data)
            if message.type is WSMsgType.TEXT:
                await client.send_str(message.data)
            elif message.type is WSMsgType.BINARY:
                await client.send_bytes(message.data)

    def _video_app(self) -> web.Application:
        app = web.Application()
        app.router.add_get("/robotether/frames", self.frames.serve)
        app.router.add_get("/robotether/topics", self._topic)
        app.router.add_get("/robotether/line", self._line)
        app.router.add_get("/stream", self._video_stream)
        app.router.add_get("/huge", self._huge)
        app.router.add_get("/raw", self._raw)
        app.router.add_get("/{path:.*}", self._snapshot)
        return app

    async def _topic(self, request: web.Request) -> web.StreamResponse:
        """Serve one topic, and echo its subscription; all of them are latched if a test says so."""
        if not self.has_topics:
            return web.Response(status=404)
        client = web.WebSocketResponse(compress=False, max_msg_size=0, timeout=0.1)
        await client.prepare(request)
        if "known" in request.query:
            for name in request.query["known"].split(",") if self.repeats else ():
                await client.send_json({"op": "robotether.known", "digest": name})
            return client
        subscription = await client.receive_str()
        self.received.append(subscription)
        await client.send_str(subscription)
        # Now, as a test may send something once.
        self.topics.append(client)
        try:
            await self._echo(client)
        finally:
            self.topics.remove(client)
        return client

    async def _line(self, _request: web.Request) -> web.Response:
        return web.Response(text=self.line_answer)

    async def send_to_topics(self, data: bytes) -> None:
        for client in list(self.topics):
            with contextlib.suppress(ConnectionError):
                await client.send_frame(data, WSMsgType.TEXT)

    def _note(self, request: web.Request) -> None:
        self.video_requests.append(
            {"path": request.raw_path, "method": request.method, "headers": dict(request.headers)}
        )

    async def _snapshot(self, request: web.Request) -> web.Response:
        self._note(request)
        response = web.Response(body=JPEG, content_type="image/jpeg")
        response.set_cookie("robot", "wants to be remembered")
        response.headers["X-Timestamp"] = "12.5"
        response.headers["Access-Control-Allow-Origin"] = "*"
        return response

    async def _video_stream(self, request: web.Request) -> web.StreamResponse:
        self._note(request)
        response = web.StreamResponse()
        response.content_type = "multipart/x-mixed-replace;boundary=frame"
        await response.prepare(request)
        with contextlib.suppress(ConnectionError):
            while True:
                await response.write(
                    b"--frame\r\nContent-Type: image/jpeg\r\n\r\n" + JPEG + b"\r\n"
                )
                await asyncio.sleep(0.01)
        return response

    async def _raw(self, request: web.Request) -> web.Response:
        self._note(request)
        assert request.transport is not None
        for part in self.raw_answer:
            request.transport.write(part)
            await asyncio.sleep(0.05)
        request.transport.close()
        return web.Response()

    async def _huge(self, request: web.Request) -> web.StreamResponse:
        self._note(request)
        response = web.StreamResponse()
        await response.prepare(request)
        self.huge_sent = 0
        with contextlib.suppress(ConnectionError):
            while True:
                await response.write(FLOOD_MESSAGE)
                self.huge_sent += len(FLOOD_MESSAGE)
        return response
