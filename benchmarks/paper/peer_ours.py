"""Robotether as one of the ways that are compared: the whole stack, and the whole agent with its guard.

It does what the others do not: TLS to the operator, tickets and permissions, a guard on the robot, pictures by credit.
The operator is on this machine, where the stack is, as the peers' operator is beside their server's side.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import ExitStack

import aiohttp
from local_network import insecure_tls
from openssh_server import descendants, wait_until
from video_viewers import OnFrame, view_frames

from paper.peer_plan import FRAMES, OURS
from paper.peer_transport import CAMERA, DRIVE, OBSERVE, STARTS_WITHIN_S, Transport
from paper.robots import WholeRobot
from paper.uplinks import Uplink
from paper.world import World

# What carries a robot's and an operator's data; web and database only let them in.
CARRIERS = ("nginx", "relay", "sshd")


class Robotether(Transport):
    """The whole of it."""

    key = OURS
    videos: Sequence[str] = (FRAMES,)
    _robot: WholeRobot

    def __init__(self, world: World, uplink: Uplink) -> None:
        super().__init__(uplink)
        self._world = world
        self._tls = insecure_tls()

    def prepare(self, made: ExitStack) -> None:
        [enrolled] = self._world.enrol(self._world.names("peers", 1))
        made.callback(self._world.remove, [enrolled])
        self._robot = WholeRobot(self._world, enrolled, self.uplink, "simulator")
        made.callback(self._robot.__exit__, None, None, None)
        self._robot.start_ros()
        wait_until(
            self._robot.answers,
            lambda: f"the simulated robot answers:\n{self._robot.logs()}",
            STARTS_WITHIN_S,
        )

    def connect(self) -> None:
        self._robot.start_agent()

    def disconnect(self) -> None:
        self._robot.end_agent()

    def check(self) -> None:
        if gone := self._robot.ended():
            raise RuntimeError(f"{gone}:\n{self._robot.logs()}")

    def words(self) -> str:
        return self._robot.logs()

    def ros_url(self, mode: str = DRIVE) -> str:
        ticket = self._world.ticket(self._robot.name, mode)
        return f"wss://{self._world.address}/robots/{self._robot.name}/ros?ticket={ticket}"

    def local_ros_url(self) -> str:
        return self._robot.ros_url

    async def view(self, http: aiohttp.ClientSession, video: str, on_frame: OnFrame) -> None:
        ticket = await asyncio.to_thread(self._world.ticket, self._robot.name, OBSERVE)
        base = f"https://{self._world.address}/robots/{self._robot.name}/video"
        await view_frames(http, f"{base}/frames?topic={CAMERA}&ticket={ticket}", on_frame)

    def connector(self) -> aiohttp.TCPConnector:
        return aiohttp.TCPConnector(force_close=True, ssl=self._tls)

    def robot_pids(self) -> list[int]:
        agent = self._robot.agent_pid
        return [agent, *descendants(agent)]

    def server_pids(self) -> list[int]:
        return [pid for service in CARRIERS for pid in self._pids(service)]

    def _pids(self, service: str) -> list[int]:
        table = self._world.container(service).top(ps_args="-eo pid")["Processes"]
        return [int(pid) for [pid] in table]
