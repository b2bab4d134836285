"""The server's end for tests of the agent: HTTPS join, a real sshd, and a fake relay with named modes.

serves         as the relay does
pending        the join waits for an approval until approve() is called
refuses_key    the join says active, and sshd does not let the key in
hangs          never a word
drops_mid_line ends the connection within its configuration
loses_answers  takes a robot's new key in exchange for the old one, and its answer to that is lost
"""

from __future__ import annotations

import asyncio
import atexit
import json
import shutil
import ssl
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import aiohttp
from aiohttp import web
from dated_certificate import fingerprint_of, make_certificate
from local_network import free_port
from openssh_server import OpenSshServer, listens
from robotether_common.join import ROTATION_NAMESPACE, rotation_message
from robotether_server.signatures import is_signed
from tcp_service import TcpService
from timed_websocket import timed_session

HEARTBEAT_S = 0.2
# Nothing here tests its end, so a busy machine must not end a connection for its silence.
TIMEOUT_S = 15.0
GUARD_KEY = "the-key-of-this-session"
WAIT_S = 30.0


@cache
def certificate() -> Path:
    place = Path(tempfile.mkdtemp(prefix="rt-tls-"))
    atexit.register(shutil.rmtree, place)
    return make_certificate(place)


@cache
def fingerprint() -> str:
    return fingerprint_of(certificate())


def agent_environ(cloud: FakeCloud, place: Path, **more: str) -> dict[str, str]:
    values = {
        "server": cloud.server,
        "tls_fingerprint": fingerprint(),
        "mac": "00:1b:44:11:3a:b7",
        "state_dir": str(place / "state"),
        "run_dir": str(place / "run"),
        **more,
    }
    return {f"ROBOTETHER_{key.upper()}": value for key, value in values.items()}


class Link:
    def __init__(self, kind: str, writer: asyncio.StreamWriter) -> None:
        self.kind = kind
        self.received: list[dict[str, Any]] = []
        self.ended = False
        self._writer = writer

    def send(self, message: dict[str, Any]) -> None:
        self.send_raw(json.dumps(message).encode() + b"\n")

    def send_raw(self, data: bytes) -> None:
        if not self._writer.is_closing():
            self._writer.write(data)

    def drop(self) -> None:
        self._writer.close()

    def of_type(self, kind: str) -> list[dict[str, Any]]:
        return [message for message in self.received if message["type"] == kind]


class FakeCloud(TcpService):
    """Start it, point an agent at `server`, and look at what came."""

    def __init__(self, mode: str = "serves", *, pem: Path | None = None) -> None:
        super().__init__()
        self.mode = mode
        self.shell_port: int | None = None
        self.media = True
        self.idle_heartbeat_s: float | None = None
        self.rotate_key = False
        # The machines of the server, as it lists them.
        self.cells: list[dict[str, Any]] | None = None
        # What the agent's guard is to go by.
        self.guard: dict[str, Any] = {"key": GUARD_KEY}
        self.checked = {"ros": "ok", "video": "down", "shell": "unknown"}
        self.robot_key = ""
        self._pem = pem or certificate()
        self.ports = (free_port(), free_port())
        self.other_ports = (free_port(), free_port())
        self.joins: list[dict[str, Any]] = []
        self.links: list[Link] = []
        self.answer: Callable[[], web.Response] = self.active
        self.greeting: Callable[[], web.Response] = self.where
        self.refuses_rotation: Callable[[], web.Response] | None = None
        self._approved = False

    async def start(self) -> None:
        await self.__aenter__()
        self.ssh = OpenSshServer(self.port)
        await asyncio.to_thread(self.ssh.start)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(self._pem)
        app = web.Application()
        app.router.add_post("/api/v1/join", self._join)
        app.router.add_get("/api/v1/ssh", self._greet)
        self._web = web.AppRunner(app, access_log=None)
        await self._web.setup()
        site = web.TCPSite(self._web, "127.0.0.1", 0, ssl_context=context)
        await site.start()
        self.server = f"127.0.0.1:{self._web.addresses[0][1]}"

    async def stop_web(self) -> None:
        await self._web.cleanup()

    async def close(self) -> None:
        await self._web.cleanup()
        await asyncio.to_thread(self.ssh.close)
        await self.__aexit__()

    def approve(self) -> None:
        self._approved = True
        if self.joins:
            self.authorize(self.joins[-1]["public_key"])

    def remove_robot(self) -> None:
        """Forget the key, so that the robot has to be approved again."""
        self.mode, self._approved = "pending", False
        self.ssh.authorized.write_text("")

    @property
    def cell(self) -> dict[str, Any]:
        return {"host": "127.0.0.1", "ports": [self.ssh.port]}

    async def be_of_site(self, first: FakeCloud) -> None:
        await asyncio.to_thread(self.ssh.stop)
        self.ssh.take_host_key(first.ssh)
        await asyncio.to_thread(self.ssh.start)

    def configure(self, **changes: Any) -> None:
        """Change `cells`, `shell_port`, `media`, `rotate_key` or `guard`, and tell the session, as the relay does."""
        for name, value in changes.items():
            setattr(self, name, value)
        self.authorize(self.robot_key)
        for link in self.of_kind("session"):
            link.send(self._config(self.ports))

    def authorize(self, public_key: str) -> None:
        shell = () if self.shell_port is None else (self.shell_port,)
        self.robot_key = public_key
        self.ssh.authorize(public_key, self.ports + self.other_ports + shell)

    def active(self) -> web.Response:
        return web.json_response({"state": "active", "robot": "sim1", "ssh": self._access()})

    def where(self) -> web.Response:
        """The answer to anybody who asks where robots connect, by which a Robotether server is known."""
        return web.json_response({"ssh": self._access()})

    def _access(self) -> dict[str, Any]:
        where = {"user": self.ssh.user, "host": None, "ports": [self.ssh.port]}
        return {**where, "host_keys": self.ssh.host_keys, **self._listed()}

    def of_kind(self, kind: str, *, live: bool = True) -> list[Link]:
        """Return the links of a kind; only those that stand, unless told otherwise."""
        return [link for link in self.links if link.kind == kind and not (live and link.ended)]

    async def link(self, kind: str, *, number: int = 1) -> Link:
        """Wait for the link `number` of a kind, counted from 1 and with those that ended."""
        await eventually(
            lambda: len(self.of_kind(kind, live=False)) >= number,
            lambda: f"{kind} number {number} at the relay; sshd's log:\n{self.ssh.log_text()}",
        )
        return self.of_kind(kind, live=False)[number - 1]

    async def _join(self, request: web.Request) -> web.Response:
        self.joins.append(await request.json())
        if self.mode == "pending" and not self._approved:
            body = {
                "state": "pending",
                "robot": "robot-00000a",
                "code": "approval_pending",
                "detail": "an admin approves it with: robotether robot approve robot-00000a",
            }
            return web.json_response(body, status=202)
        if "previous_key" in self.joins[-1]:
            return await self._rotate(self.joins[-1])
        if self.mode != "refuses_key":
            self.approve()
        return self.answer()

    async def _rotate(self, said: dict[str, Any]) -> web.Response:
        if self.refuses_rotation is not None:
            return self.refuses_rotation()
        if self.robot_key != said["public_key"]:
            message = rotation_message(said["mac"], said["public_key"])
            signature = said["previous_key"]["signature"]
            if not is_signed(self.robot_key, ROTATION_NAMESPACE, message, signature):
                detail = "the signature is not the robot's key's"
                return web.json_response({"code": "field_invalid", "detail": detail}, status=422)
            self.authorize(said["public_key"])
            self.rotate_key = False
        if self.mode == "loses_answers":
            return web.Response(status=502)
        return self.answer()

    async def _greet(self, _: web.Request) -> web.Response:
        return self.greeting()

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        preface = json.loads(await reader.readline())
        link = Link(preface["kind"], writer)
        self.links.append(link)
        try:
            await self._serve_link(link, reader)
        finally:
            link.ended = True

    async def _serve_link(self, link: Link, reader: asyncio.StreamReader) -> None:
        if self.mode == "hangs":
            await reader.read()
            return
        if self.mode == "drops_mid_line":
            link.send_raw(b'{"type": "conf')
            return
        link.send(self._config(self.ports))
        pings = asyncio.ensure_future(self._send_pings(link))
        try:
            while line := await reader.readline():
                message = json.loads(line)
                link.received.append(message)
                if message["type"] == "ping":
                    link.send({"type": "pong", "seq": message["seq"], "t_ms": message["t_ms"]})
                elif message["type"] == "check":
                    link.send({"type": "checked", **self.checked})
        finally:
            pings.cancel()

    async def _send_pings(self, link: Link) -> None:
        seq = 0
        while True:
            seq += 1
            link.send({"type": "ping", "seq": seq})
            await asyncio.sleep(HEARTBEAT_S)

    def _listed(self) -> dict[str, Any]:
        return {} if self.cells is None else {"cells": self.cells}

    def _config(self, ports: tuple[int, int]) -> dict[str, Any]:
        return {
            "type": "config",
            "robot": "sim1",
            "ros_port": ports[0],
            "video_port": ports[1],
            "heartbeat_s": HEARTBEAT_S,
            "idle_heartbeat_s": self.idle_heartbeat_s,
            "timeout_s": TIMEOUT_S,
            "shell_port": self.shell_port,
            "media": self.media,
            "rotate_key": self.rotate_key,
            "guard": self.guard,
            "direct": False,
            **self._listed(),
        }


async def echo(port: int, text: str, *, key: str = GUARD_KEY) -> str:
    """Send `text` through the server's `port` to the robot's WebSocket, and return what comes back.

    A session is up before its guard is ready, and the port leads nowhere until then.
    """
    await eventually(lambda: listens(port), lambda: f"port {port} leads to the robot")
    headers = {"Robotether-Key": key, "Robotether-Mode": "observe"}
    async with (
        timed_session(headers=headers) as http,
        http.ws_connect(f"ws://127.0.0.1:{port}/", timeout=aiohttp.ClientWSTimeout(5, 5)) as robot,
    ):
        await robot.send_json({"op": "call_service", "service": "/echo", "id": text})
        return str((await robot.receive_json(timeout=5))["id"])


async def eventually(
    condition: Callable[[], bool], what: Callable[[], str], within_s: float = WAIT_S
) -> None:
    """Wait, bounded, until `condition()`; `what()` tells in the failure what was waited for."""
    loop = asyncio.get_running_loop()
    deadline = loop.time() + within_s
    while not condition():
        if loop.time() > deadline:
            raise AssertionError(f"not within {within_s:g} s: {what()}")
        await asyncio.sleep(0.02)
