"""What a simulated robot really does, seen on its own rosbridge and not through the server.

The engine lets this machine reach a container's own address, which nothing behind the server can. A thread of its own
listens, so that a synchronous browser test can look at any time.
"""

from __future__ import annotations

import json
import time
from collections import deque
from dataclasses import dataclass
from itertools import takewhile
from typing import Any, Protocol

import aiohttp
from docker.models.containers import Container
from docker_engine import address_of
from loop_thread import LoopThread

# Time limit for a pose that the robot is to reach.
POSE_WITHIN_S = 10.0


class Containers(Protocol):
    def container(self, service: str) -> Container: ...


@dataclass(frozen=True)
class Seen:
    """One message with the moment it arrived, in seconds of time.monotonic()."""

    at: float
    msg: dict[str, Any]


class SimWatch(LoopThread):
    """Subscribes to a simulator's /pose and /cmd_vel for as long as the `with` block runs."""

    # In the order in which they are subscribed to: with the first message of the last one, which never ends, commands
    # come too.
    topics = ("/cmd_vel", "/pose")

    def __init__(self, stack: Containers, sim: str) -> None:
        self._url = f"ws://{address_of(stack.container(sim))}:9090/"
        super().__init__(f"{self.topics[-1]} from {self._url}")
        self._seen: dict[str, deque[Seen]] = {topic: deque(maxlen=4000) for topic in self.topics}

    @property
    def pose(self) -> dict[str, float]:
        """The newest turtlesim/Pose: x, y in m, theta in rad, velocities in m/s and rad/s."""
        return self._seen["/pose"][-1].msg

    def commands(self, since: float = 0.0) -> list[Seen]:
        return [seen for seen in list(self._seen["/cmd_vel"]) if seen.at > since]

    def wait_seen(self, what: str, condition: Any, since: float) -> None:
        """Wait for a pose after `since` for which the condition held; the robot may have moved on."""

        def came(_: object) -> bool:
            poses = reversed(list(self._seen["/pose"]))
            return any(
                condition(seen.msg) for seen in takewhile(lambda item: item.at > since, poses)
            )

        self.wait_pose(what, came)

    def wait_moving(self) -> None:
        """Wait until it goes at any speed: who drives without video is very slow."""
        self.wait_pose("moving", lambda pose: pose["linear_velocity"] > 0)

    def wait_standing(self, what: str = "standing") -> None:
        self.wait_pose(
            what, lambda pose: pose["linear_velocity"] == 0 and pose["angular_velocity"] == 0
        )

    def wait_pose(self, what: str, condition: Any) -> None:
        start = time.monotonic()
        while not condition(self.pose):
            late = f"after {POSE_WITHIN_S} s still not {what}: {self.pose}"
            assert time.monotonic() - start < POSE_WITHIN_S, late
            time.sleep(0.01)

    async def _work(self) -> None:
        async with aiohttp.ClientSession() as http, http.ws_connect(self._url) as socket:
            for topic in self._seen:
                await socket.send_json({"op": "subscribe", "topic": topic})
            async for frame in socket:
                message = json.loads(frame.data)
                if message.get("op") == "publish":
                    self._seen[message["topic"]].append(Seen(time.monotonic(), message["msg"]))
                    if message["topic"] == self.topics[-1]:
                        self._begun.set()
