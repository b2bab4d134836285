"""A guard as its agent runs it: a process with two pipes, and clients as the relay is one."""

from __future__ import annotations

import asyncio
import json
import os
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from fake_pipe import FakePipe
from robotether_agent.clock import robot_time
from robotether_agent.guard.agent_messages import GuardReporter
from robotether_agent.guard.process import MAX_LINE_BYTES, Guard
from robotether_agent.rosbridge_socket import new_http
from timed_websocket import SocketClient

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = os.pathsep.join(str(ROOT / name) for name in ("common", "agent"))
KEY = "the key of this test"
TICK_EVERY_S = 0.2
WAIT_S = 20.0


class GuardEnd(ABC):
    """The agent's end of a guard in `place`: it sends a tick every 0.2 s until `silence`."""

    def __init__(self, place: Path, rosbridge_port: int, **guard: Any) -> None:
        self.place = place
        self.lines: list[dict[str, Any]] = []
        self.config: dict[str, Any] = {
            "type": "config",
            "rosbridge_url": f"ws://127.0.0.1:{rosbridge_port}/",
            "guard": {"key": KEY, **guard},
            "direct": False,
        }
        self._tasks: list[asyncio.Task[None]] = []
        self._ticks = True
        self._asked = 0

    async def __aenter__(self) -> Self:
        await self._start()
        self._tasks.append(asyncio.create_task(self._tick()))
        self.tell(**self.config)
        try:
            await self.until(lambda: self.port > 0 and len(self.lines) > 1, "it listens")
        except BaseException:
            await self.__aexit__()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._end()

    @abstractmethod
    async def _start(self) -> None: ...

    @abstractmethod
    async def _end(self) -> None: ...

    @abstractmethod
    def write(self, data: bytes) -> None: ...

    def tell(self, **line: Any) -> None:
        self.write(json.dumps(line).encode() + b"\n")

    def reconfigure(self, **config: Any) -> None:
        self.config |= config
        self.tell(**self.config)

    async def grant(self, fence: int) -> None:
        """Say that the session stands and this lease is held; wait until that is heard."""
        self.tell(type="session", up=True)
        self.tell(type="lease", fence=fence, held=True)
        await self.heard()

    async def heard(self) -> None:
        """Wait until the guard has heard all that it was told; asks for a release, which is answered in turn."""
        if self.state["stopped"]:
            return
        self._asked += 1
        identity = f"heard {self._asked}"
        self.tell(type="release", id=identity, by="")
        await self.until(lambda: self.state["answers"] == identity, "it has heard")

    def silence(self) -> None:
        self._ticks = False

    @property
    def port(self) -> int:
        return next((line["port"] for line in self.lines if line["type"] == "ready"), 0)

    @property
    def state(self) -> dict[str, Any]:
        return [line for line in self.lines if line["type"] == "guard"][-1]

    async def until(
        self, condition: Callable[[], bool], what: str, seconds: float = WAIT_S
    ) -> None:
        end = time.monotonic() + seconds
        while not condition():
            reports = [line for line in self.lines if line["type"] != "tick"]
            assert time.monotonic() < end, f"after {seconds} s still not: {what}; it said {reports}"
            await asyncio.sleep(0.005)

    async def _tick(self) -> None:
        while True:
            if self._ticks:
                self.tell(type="tick")
            await asyncio.sleep(TICK_EVERY_S)


class GuardHere(GuardEnd):
    """A guard in the tests' own process, where coverage and mutants see it."""

    async def _start(self) -> None:
        self._lines = asyncio.StreamReader(limit=MAX_LINE_BYTES)
        self._http = new_http()
        pipe = FakePipe()
        self.lines = pipe.lines
        guard = Guard(self._http, self.place, self.place, GuardReporter(pipe))
        self._tasks.append(asyncio.create_task(guard.run(self._lines)))

    async def _end(self) -> None:
        await self._http.close()

    def write(self, data: bytes) -> None:
        self._lines.feed_data(data)


class GuardProcess(GuardEnd):
    def __init__(self, *where: Any, **guard: Any) -> None:
        super().__init__(*where, **guard)
        self.process: asyncio.subprocess.Process
        # Where its log goes; None: where this process's goes.
        self.stderr: int | None = None

    async def _start(self) -> None:
        self.process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "robotether_agent.guard",
            f"--state-dir={self.place}",
            f"--run-dir={self.place}",
            env={**os.environ, "PYTHONPATH": PACKAGES},
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=self.stderr,
        )
        self._tasks.append(asyncio.create_task(self._read()))

    async def _end(self) -> None:
        if self.process.returncode is None:
            with suppress(ProcessLookupError):
                self.process.kill()
            await self.process.wait()
        # asyncio's own transport keeps the pipes until it is closed.
        self.process._transport.close()  # type: ignore[attr-defined]

    def write(self, data: bytes) -> None:
        assert self.process.stdin is not None
        if not self.process.stdin.is_closing():
            self.process.stdin.write(data)

    def leave(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()

    async def ended(self) -> int:
        return await asyncio.wait_for(self.process.wait(), WAIT_S)

    async def _read(self) -> None:
        assert self.process.stdout is not None
        async for line in self.process.stdout:
            self.lines.append(json.loads(line))


class GuardClient(SocketClient):
    """A WebSocket to the guard, as the relay opens it; fence 0 observes, None has no key."""

    def __init__(self, port: int, fence: int | None = 0) -> None:
        mode = "drive" if fence else "observe"
        headers = {"Robotether-Key": KEY, "Robotether-Mode": mode, "Robotether-Fence": str(fence)}
        super().__init__(port, **({} if fence is None else headers))
        self._fence = fence

    async def drive(
        self, speed: float, *, turn: float = 0.0, age_ms: float = 0.0, **more: Any
    ) -> None:
        stamp = {"t_ms": robot_time() * 1000 - age_ms, "fence": self._fence}
        fields: dict[str, Any] = {"topic": "/cmd_vel", "robotether": stamp, **more}
        message = {"linear": {"x": speed}, "angular": {"z": turn}}
        await self.send(op="publish", **({"msg": message} | fields))

    async def closed(self) -> int:
        return (await self.close_reason())[0]

    async def close_reason(self) -> tuple[int, str]:
        reason = ""
        while not self.socket.closed:
            message = await self.socket.receive(timeout=WAIT_S)
            reason = message.extra or reason
        return int(self.socket.close_code or 0), reason
