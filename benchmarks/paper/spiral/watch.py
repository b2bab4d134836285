"""A process that watches robots at their own rosbridges, in their networks: what reached them, and how they moved.

Started by spiral.py, apart from the operators so that neither disturbs the other's times. The first line of stdin
is a JSON list of {"namespace", "url"}, one a robot. It answers with the line "watching" when each of them has shown its
pose. At the next line it waits until all stand, writes a JSON list of what each did, and ends; also at the end of
stdin, so that it never outlives its owner. Must send the robots nothing but subscriptions.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

import aiohttp
from namespaces import Namespace
from sim_robot.kinematics import STEP_S

from paper.client import new_http
from paper.networks import made_in
from paper.programs import write_line

CMD_VEL, POSE = "/cmd_vel", "/pose"
TYPES = {CMD_VEL: "geometry_msgs/Twist", POSE: "turtlesim/Pose"}
BEGINS_WITHIN_S, STANDS_WITHIN_S = 15.0, 5.0
POLL_S = 0.02


class Watch:
    """One robot's commands as they arrived and its steps as it took them."""

    def __init__(self, namespace: str, url: str) -> None:
        self._inside = Namespace(namespace, "")
        self._url = url
        self.problem = ""
        # (time.monotonic_ns() on arrival, m/s, rad/s)
        self._arrived: list[tuple[int, float, float]] = []
        # Speeds of the poses in which it moved: turtlesim shows one a step.
        self._moved: list[float] = []
        self._before: Mapping[str, float] | None = None
        self._newest: Mapping[str, float] | None = None

    async def run(self) -> None:
        try:
            async with (
                new_http(**made_in(self._inside)) as http,
                http.ws_connect(self._url, max_msg_size=0, compress=0) as rosbridge,
            ):
                for topic, kind in TYPES.items():
                    await rosbridge.send_json({"op": "subscribe", "topic": topic, "type": kind})
                async for frame in rosbridge:
                    self.note(time.monotonic_ns(), json.loads(frame.data))
            self.problem = "the robot's rosbridge closed the connection"
        except (OSError, aiohttp.ClientError) as error:
            self.problem = f"cannot watch {self._url}: {error}"

    def note(self, at_ns: int, operation: Mapping[str, Any]) -> None:
        """Keep what one message of the robot's rosbridge tells."""
        if operation.get("op") != "publish":
            return
        message = operation["msg"]
        if operation["topic"] == CMD_VEL:
            self._arrived.append((at_ns, message["linear"]["x"], message["angular"]["z"]))
            return
        self._newest = message
        if message["linear_velocity"] or message["angular_velocity"]:
            self._moved.append(message["linear_velocity"])
        elif not self._moved:
            self._before = message

    @property
    def watches(self) -> bool:
        """Whether the robot has shown where it stands, or never will."""
        return self._before is not None or bool(self.problem)

    @property
    def stands(self) -> bool:
        """Whether the robot does not move, or cannot be seen any more."""
        newest = self._newest
        return bool(self.problem) or (newest is not None and not newest["linear_velocity"])

    def reported(self) -> dict[str, Any]:
        """What was seen: poses are [x, y, theta] in the simulator's frame, times in time.monotonic_ns()."""
        return {
            "problem": self.problem,
            "arrived": self._arrived,
            "start": _pose(self._before),
            "end": _pose(self._newest),
            "stands": self.stands,
            "steps": len(self._moved),
            "travelled_m": sum(self._moved) * STEP_S,
        }


def _pose(pose: Mapping[str, float] | None) -> list[float] | None:
    # turtlesim's numbers are exact to a micrometre and no further.
    return None if pose is None else [round(pose[part], 6) for part in ("x", "y", "theta")]


async def wait_all(watches: Sequence[Watch], what: str, seconds: float) -> bool:
    """Wait until each of them is `what`, at most so long; whether it came to that."""
    end = time.monotonic() + seconds
    while not all(getattr(watch, what) for watch in watches):
        if time.monotonic() > end:
            return False
        await asyncio.sleep(POLL_S)
    return True


async def watch_all(targets: Sequence[Mapping[str, str]], lines: asyncio.StreamReader) -> None:
    watches = [Watch(target["namespace"], target["url"]) for target in targets]
    tasks = [asyncio.create_task(watch.run()) for watch in watches]
    try:
        await wait_all(watches, "watches", BEGINS_WITHIN_S)
        write_line("watching")
        if await lines.readline():
            await wait_all(watches, "stands", STANDS_WITHIN_S)
            write_line([watch.reported() for watch in watches])
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def main() -> None:
    lines = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(lines), sys.stdin
    )
    await watch_all(json.loads(await lines.readline()), lines)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt, BrokenPipeError):
        asyncio.run(main())
