"""What the tests of attacks take into their hands: people with little rights, their cookies and tickets, raw requests.

Everything goes through the running stack's own nginx, as somebody outside would send it; the library of an honest
client would not let most of it out.
"""

from __future__ import annotations

import asyncio
import http.client
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from local_network import insecure_tls
from logins import Login
from programs import Program
from stack import Stack

UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}
LOGIN_COOKIE = "__Host-robotether_login"
OPEN = "open"


@dataclass(frozen=True)
class Answer:
    """What came back; `body` is at most its first 64 KB."""

    status: int
    headers: Mapping[str, str]
    body: str

    @property
    def code(self) -> str:
        """The problem's short code; `OPEN` for what was let in, else nothing."""
        if self.status in {101, 200, 201, 204}:
            return OPEN
        try:
            return str(json.loads(self.body).get("code", ""))
        except ValueError:
            return ""

    @property
    def said(self) -> str:
        """Status and code in one, as the tables of the tests write it."""
        return f"{self.status} {self.code}".strip()


def raw(
    stack: Stack,
    method: str,
    path: str,
    *,
    headers: Mapping[str, str] | None = None,
    body: object = None,
) -> Answer:
    sent = dict(headers or {})
    data = None if body is None else json.dumps(body)
    if data is not None:
        sent.setdefault("Content-Type", "application/json")
    connection = http.client.HTTPSConnection(
        "localhost", stack.https_port, timeout=10, context=insecure_tls()
    )
    try:
        connection.request(method, path, body=data, headers=sent)
        answer = connection.getresponse()
        endless = answer.status == http.HTTPStatus.SWITCHING_PROTOCOLS or (
            answer.headers.get_content_type() in {"text/event-stream", "multipart/x-mixed-replace"}
        )
        text = "" if endless else answer.read(65536).decode(errors="replace")
        return Answer(answer.status, dict(answer.headers), text)
    finally:
        connection.close()


class Person:
    def __init__(self, stack: Stack, name: str, *grants: tuple[str, str]) -> None:
        self.stack = stack
        self.name = name
        self.password = stack.admin.add_user(name)
        for robot, level in grants:
            stack.admin.grant(name, robot, level)
        self.token = stack.token("attacks", name)
        self.program = Program(stack, self.token)
        self.bearer = {"Authorization": f"Bearer {self.token}"}
        self._cookie: dict[str, str] | None = None
        for robot, _ in grants:
            stack.wait_for_right(name, robot)

    @property
    def cookie(self) -> dict[str, str]:
        """The header of a browser in which this person is logged in, and nothing else of that browser."""
        if self._cookie is None:
            self._cookie = self._log_in()
        return self._cookie

    def ticket(self, robot: str, mode: str = "observe") -> str:
        return self.program.ticket(robot, mode)

    def ask(self, method: str, path: str, body: object = None) -> Answer:
        return raw(self.stack, method, path, headers=self.bearer, body=body)

    def _log_in(self) -> dict[str, str]:
        cookies = Login(self.stack.url, self.name, self.password).cookies
        return {"Cookie": f"{LOGIN_COOKIE}={cookies[LOGIN_COOKIE]}"}


def open_ros(stack: Stack, robot: str, ticket: str | None, **headers: str) -> Answer:
    """Ask for a robot's rosbridge with an upgrade; a connection that opens is closed at once."""
    query = "" if ticket is None else f"?ticket={ticket}"
    return raw(stack, "GET", f"/robots/{robot}/ros{query}", headers={**UPGRADE, **headers})


async def refusal_of(socket: Any, data: str | bytes) -> str:
    """Send one message as it stands; why the relay refuses it, as rosbridge says that of its kind."""
    await (socket.send_bytes(data) if isinstance(data, bytes) else socket.send_str(data))
    while True:
        message = json.loads(await asyncio.wait_for(socket.receive_str(), 5))
        if why := message.get(
            {"status": "msg", "service_response": "values"}.get(message["op"], "")
        ):
            return str(why)
