"""A process of robots that write their history, started by workload.py in an uplink's namespace.

Some are the real agent with its own OpenSSH clients, the others virtual (paper.virtual). Each has the guard's own code
and a rosbridge, both in this process; what comes to the guard, what it confirms and what it lets through is written
down. In: a line that says where to write and which robots there are, then orders. Out: `done` for each.
"""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from aiohttp import web
from fake_cameras import FakeVideoServer
from robotether_agent.daemon import report_guard
from robotether_agent.fields import JsonObject
from robotether_agent.guard.drive_messages import DriveMessage
from robotether_agent.net.server_dialer import SshAddress
from robotether_agent.settings import Settings
from robotether_agent.topics_service import TopicsService
from robotether_agent.tunnel.openssh import ServiceAddress
from robotether_agent.tunnel.session import Session
from robotether_common.guard import STAMP
from robotether_common.topics import PATH
from sim_robot.graph import Node, TopicMessage

from paper.cells.history import History
from paper.client import TOPIC, TYPE, origin
from paper.fleet.worker import (
    LightAgent,
    Robots,
    RosRobot,
    SupervisorHere,
    Watch,
    main,
    standard_input,
    watch_children,
)
from paper.virtual.robot import Account, VirtualRobot
from paper.virtual.services import LOCALHOST

# A turn of this loop that comes so much later than it should is written down.
TURN_EVERY_S, LATE_S = 0.02, 0.01
FPS = 5.0


class HistoryWatch(Watch):
    def __init__(self, robot: str, history: History) -> None:
        self._add = partial(history.add, robot=robot)
        # The names of cells by their SSH addresses.
        self.cells: Mapping[str, str] = {}
        # What stops and releases under way are, by their ids.
        self._orders: dict[str, str] = {}
        self._epoch = 0

    def on_arrived(self, message: DriveMessage) -> None:
        if message.operation != "publish":
            return
        stamp, sent = message.fields.get(STAMP), origin(message.fields["msg"])
        if sent is not None and isinstance(stamp, dict):
            connection, number = sent
            self._add("arrived", connection=connection, number=number, fence=stamp["fence"])

    def on_command(self, message: TopicMessage) -> None:
        sent = origin(message.values)
        if sent is None:
            self._add("zeroed")
        else:
            self._add("moved", connection=sent[0], number=sent[1])

    def on_order(self, line: Mapping[str, object]) -> None:
        if line["type"] in ("stop", "release"):
            self._orders[str(line["id"])] = str(line["type"])

    def on_report(self, line: JsonObject) -> None:
        order = self._orders.pop(str(line.get("answers")), "")
        if order == "stop" and line["stopped"]:
            self._add("stopped", what=str(line["by"]))
        elif order == "release" and not line["stopped"]:
            self._add("released")

    def on_guard(self, *, killed: bool) -> None:
        self._add("guard_killed" if killed else "guard_began")

    def on_session(self, address: SshAddress, epoch: int) -> None:
        if epoch != self._epoch:
            self._epoch = epoch
            at = f"{address.host}:{address.port}"
            self._add("session", cell=self.cells.get(at, at), epoch=epoch)

    def on_session_lost(self) -> None:
        self._add("session_lost")


class GuardedSide:
    """Behind a virtual robot's forwards: a guard as an agent has it, and the robot's topics."""

    def __init__(self, settings: Settings, watch: Watch) -> None:
        self.moved = asyncio.Event()
        self.supervisor = SupervisorHere(settings, watch, on_change=lambda _: self.moved.set())
        self.on_config, self.on_lease = self.supervisor.on_config, self.supervisor.on_lease
        self.on_stop, self.on_release = self.supervisor.on_stop, self.supervisor.on_release
        self.on_session_lost = self.supervisor.on_session_lost
        self._topics_service = TopicsService(settings.rosbridge_url)
        self._topics_port = 0

    async def run(self) -> None:
        app = web.Application()
        app.router.add_get(PATH, self._topics_service.answer)
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=0.1)
        await runner.setup()
        try:
            await web.TCPSite(runner, LOCALHOST, 0).start()
            self._topics_port = runner.addresses[0][1]
            await self.supervisor.run()
        finally:
            await runner.cleanup()
            await self._topics_service.close()

    def ros_target(self) -> ServiceAddress | None:
        port = self.supervisor.view.port
        return None if port is None else ServiceAddress(LOCALHOST, port)

    def topics_target(self) -> ServiceAddress:
        return ServiceAddress(LOCALHOST, self._topics_port)

    async def report(self, session: Session) -> None:
        await report_guard(self.supervisor, session)


class CellRobot(RosRobot):
    """One robot, agent or virtual; its guard's disk is in the folder that the settings name."""

    def __init__(self, name: str, given: Mapping[str, str], history: History) -> None:
        super().__init__(name, given)
        self.watch = HistoryWatch(name, history)
        self.bus.graph.bus.subscribe(TOPIC, TYPE, Node("/listener"), self.watch.on_command)
        self.supervisor: SupervisorHere | None = None


class RealRobot(CellRobot):
    async def play(self) -> None:
        agent = LightAgent(self.settings(), self.watch)
        self.supervisor = agent.supervisor
        await agent.run()


class PlayedRobot(CellRobot):
    async def play(self) -> None:
        side = GuardedSide(self.settings(), self.watch)
        self.supervisor = side.supervisor
        robot = VirtualRobot(Account.read(self._given), side, random.SystemRandom())
        robot.on_session = self.watch.on_session
        robot.on_session_lost = self.watch.on_session_lost
        async with asyncio.TaskGroup() as group:
            group.create_task(side.run())
            group.create_task(robot.run())


class CellRobots(Robots):
    robots: Mapping[str, CellRobot]

    async def obey(
        self, do: str, cells: Mapping[str, str] | None = None, robots: Sequence[str] = ()
    ) -> None:
        if do == "kill_guards":
            chosen = [self.robots[name].supervisor for name in robots]
            await asyncio.gather(*(part.kill() for part in chosen if part is not None))
            return
        for robot in self.robots.values():
            robot.watch.cells = cells or robot.watch.cells
        await super().obey(do)


async def keep_time(history: History) -> None:
    """Write down when this process was held up: what it then does too late is no robot's fault."""
    while True:
        due = time.monotonic() + TURN_EVERY_S
        await asyncio.sleep(TURN_EVERY_S)
        late_s = time.monotonic() - due
        if late_s > LATE_S:
            history.add("late", number=round(late_s * 1000))


async def work(wanted: Mapping[str, Any], run_dirs: Path) -> None:
    watch_children()
    history = History.open(Path(wanted["folder"]), wanted["source"])
    async with FakeVideoServer(fps=FPS) as video:
        robots: dict[str, CellRobot] = {}
        for kind, make in (("agents", RealRobot), ("virtual", PlayedRobot)):
            for name, given in wanted[kind].items():
                run_dir = run_dirs / str(len(robots))
                run_dir.mkdir()
                local = {"run_dir": str(run_dir), "video_url": video.url}
                robots[name] = make(name, {**given, **local}, history)
        clock = asyncio.create_task(keep_time(history))
        try:
            await CellRobots(robots).serve(await standard_input())
        finally:
            clock.cancel()
            history.close()


if __name__ == "__main__":
    main(work)
