"""A drive controller of the guard with a line, a clock and connections of the tests."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from robotether_agent.guard.agent_messages import GuardConfig
from robotether_agent.guard.authorizer import Authorizer
from robotether_agent.guard.drive_controller import DriveController
from robotether_agent.guard.drive_messages import drive_message
from robotether_agent.guard.seen_age import DriverView
from robotether_agent.guard.topics import Authorization, Driven, MotionFile
from robotether_common.guard import RefusedKind

CONFIG = GuardConfig("ws://127.0.0.1:9090", "k1")
DRIVER = Authorization("drive", 13)


class FakePublisher:
    """Keeps what is sent; `full` and `silent` are a rosbridge's moods."""

    def __init__(self) -> None:
        self.sent: list[dict[str, Any]] = []
        self.up = True
        self.full = False
        self.breaks = False
        self.read_until = 1000.0

    @property
    def can_send(self) -> bool:
        return self.up and not self.full

    async def send(self, data: bytes) -> bool:
        if self.breaks:
            return False
        self.sent.append(json.loads(data))
        return True

    @property
    def speeds(self) -> list[float]:
        return [m["msg"]["linear"]["x"] for m in self.sent if m["op"] == "publish"]


class FakeSource:
    def __init__(self, authorization: Authorization = DRIVER) -> None:
        self.authorization = authorization
        self.view = DriverView()
        self.refused: list[tuple[RefusedKind, str]] = []
        self.notified: list[bytes] = []

    def refuse(self, kind: RefusedKind, text: str, message_id: str | int | None) -> None:
        self.refused.append((kind, text))

    def notify(self, data: bytes) -> None:
        self.notified.append(data)

    @property
    def kinds(self) -> list[str]:
        return [kind for kind, _ in self.refused]


class MemoryMotionFile(MotionFile):
    def __init__(self) -> None:
        super().__init__(Path("/nowhere"))
        self.driven: list[Driven] | None = None

    def read(self) -> list[Driven] | None:
        return self.driven

    def write(self, driven: Any) -> None:
        self.driven = list(driven)

    def remove(self) -> None:
        self.driven = None


class World:
    def __init__(self, motion_file: MotionFile | None = None) -> None:
        self.now = 1000.0
        self.authorizer = Authorizer(self.now)
        self.authorizer.session(up=True)
        self.authorizer.lease(13, held=True)
        self.motion_file = motion_file or MemoryMotionFile()
        self.publisher = FakePublisher()
        self.source = FakeSource()
        self.changes = 0
        self.controller = DriveController(
            self.publisher,  # type: ignore[arg-type]  # has all that it uses
            self.authorizer,
            self.motion_file,
            lambda: self.now,
            self._changed,
        )
        self.controller.use(CONFIG)

    def _changed(self) -> None:
        self.changes += 1

    async def send(self, source: FakeSource | None = None, **fields: Any) -> None:
        """Let a message of these fields come from a connection."""
        source = source or self.source
        message = {"topic": "/cmd_vel", **fields}
        found = drive_message(json.dumps(message).encode(), CONFIG.topics)
        assert found is not None
        await self.controller.handle(source, found)

    async def drive(
        self, speed: float, source: FakeSource | None = None, age_ms: float = 0, **fields: Any
    ) -> None:
        stamp = {"t_ms": self.now * 1000 - age_ms, "fence": 13}
        message = {"robotether": stamp, "msg": {"linear": {"x": speed}}, **fields}
        await self.send(source, op="publish", **message)

    async def pass_time(self, seconds: float, step_s: float = 0.01) -> None:
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.now += step_s
            self.authorizer.on_agent_message(self.now)
            await self.controller.step()
