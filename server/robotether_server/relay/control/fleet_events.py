"""The robot objects of the fleet, and which of them have changed since somebody was notified.

`channels/events`, `channels/recorder` and `cells/feed` follow it. A follower remembers which robots changed and not
how, so a slow one gets each robot's newest state once, and is never larger than the fleet. Robots of other cells are
in it, too.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from msgspec.structs import asdict

from robotether_server.contract.offline import offline_reason
from robotether_server.contract.robots import LiveState, RemovedRobot, RobotObject
from robotether_server.db.fleet import RelayRequest, RelayRobot, Snapshot
from robotether_server.relay.auth.connections import Connections
from robotether_server.relay.control.control import Control
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import Change
from robotether_server.tasks import wait_for_event
from robotether_server.times import rfc3339

RTT_NOTIFY_EVERY_S = 2.0
# States of a request for help; of a robot's requests the last of these counts.
HELP_STATES = ("waiting", "offered", "accepted")

# Its name, and what is sent.
Event = tuple[str, list[RobotObject] | RobotObject | RemovedRobot]


class ChangedRobots(ABC):
    """A follower: which robots changed since it was notified of them."""

    def __init__(self) -> None:
        self._pending: set[int] = set()
        self._wake = asyncio.Event()
        self.ended = False

    def add(self, *robot_ids: int) -> None:
        """Remember that robots changed."""
        self._pending.update(robot_ids)
        self._wake.set()

    def mark(self, robot_id: int) -> None:
        """Remember that a robot changed, if it concerns this follower."""
        self.add(robot_id)

    @abstractmethod
    def mark_all(self) -> None:
        """Remember that anything may have changed."""

    def pop(self) -> list[int]:
        """Return the robots that changed; afterwards nothing is pending."""
        pending, self._pending = self._pending, set()
        return sorted(pending)

    def end(self) -> None:
        """Let whoever follows go."""
        self.ended = True
        self._wake.set()

    async def wait(self, timeout_s: float) -> None:
        """Wait until something is to be sent, at most `timeout_s`."""
        await wait_for_event(self._wake, timeout_s)


class FleetEvents:
    """Joins rows, sessions and connections into one object a robot.

    `elsewhere` gives the part that sessions and connections have of a robot at another cell, None if it is at none.
    """

    def __init__(
        self,
        snapshot: Callable[[], Snapshot],
        registry: SessionRegistry,
        connections: Connections,
        control: Control,
        elsewhere: Callable[[int], LiveState | None],
    ) -> None:
        self._snapshot = snapshot
        self._registry = registry
        self._connections = connections
        self._control = control
        self._elsewhere = elsewhere
        # Whether the database says which robots ask for help.
        self._knows_help = False
        self._subscribers: set[Subscriber] = set()
        self._followers: set[ChangedRobots] = set()

    @contextmanager
    def subscribed(self, user_id: int) -> Iterator[Subscriber]:
        """Make a subscriber for a user; it is notified of changes inside the block."""
        subscriber = Subscriber(self, user_id)
        self._subscribers.add(subscriber)
        try:
            with self.followed(subscriber):
                yield subscriber
        finally:
            self._subscribers.discard(subscriber)

    @contextmanager
    def followed(self, follower: ChangedRobots) -> Iterator[None]:
        """Notify of each change inside the block."""
        self._followers.add(follower)
        try:
            yield
        finally:
            self._followers.discard(follower)

    def subscriber_count(self) -> int:
        """How many clients follow."""
        return len(self._subscribers)

    def subscribers_of(self, user_id: int) -> int:
        """How many clients of this user follow."""
        return sum(subscriber.user_id == user_id for subscriber in self._subscribers)

    def changed(self, robot_id: int) -> None:
        """Something about a robot changed."""
        for follower in self._followers:
            follower.mark(robot_id)

    def on_robot_change(self, change: Change) -> None:
        """Something happened to a robot; round trips are sent at most every 2 s."""
        if change.what == "heartbeat":
            self._rtt_changed(change.robot_id)
        elif change.what != "seen":
            self.changed(change.robot_id)

    def on_snapshot(self, _snapshot: Snapshot) -> None:
        """Rows or rights changed: every robot that a subscriber shows or may show now."""
        for follower in self._followers:
            follower.mark_all()

    def on_help_requests(self, requests: Sequence[RelayRequest] | None) -> None:
        """The robots' open requests for help were read; None: they are unknown."""
        if self._knows_help is (requests is None):
            self._knows_help = requests is not None
            self.on_snapshot(self._snapshot())
        if requests is None:
            return
        states = _help_states(requests)
        for robot in {*self._registry.robots(), *map(self._registry.ensure_robot, states)}:
            if (help_state := states.get(robot.id, "none")) != robot.help_state:
                robot.help_state = help_state
                self.changed(robot.id)

    def end_subscriptions(self) -> None:
        """The relay is stopping."""
        for follower in list(self._followers):
            follower.end()

    def visible(self, user_id: int) -> list[RelayRobot]:
        """The robots that a user may see."""
        return self._snapshot().visible(user_id)

    def find(self, user_id: int, robot_id: int) -> RelayRobot | None:
        """The robot, if the user may see it."""
        snapshot = self._snapshot()
        if snapshot.level(user_id, robot_id) is None:
            return None
        return snapshot.robots.get(robot_id)

    def describe(self, robot: RelayRobot) -> RobotObject:
        """Build the robot object of the contract."""
        live = self._elsewhere(robot.id) or self.describe_here(robot.id)
        version = live.agent_version or robot.agent_version
        return RobotObject(
            name=robot.name,
            mac=robot.mac,
            state=robot.state,
            site=robot.site,
            offline_reason=_offline_reason(robot, live, version),
            help=self._registry.robot(robot.id).help_state if self._knows_help else None,
            **asdict(live) | {"agent_version": version},
        )

    def is_elsewhere(self, robot_id: int) -> bool:
        """Return whether another cell has the robot."""
        return self._elsewhere(robot_id) is not None

    def describe_here(self, robot_id: int) -> LiveState:
        """Build what of a robot object this cell knows, and no row."""
        presence, driver = self._registry.presence(robot_id), self._control.driver(robot_id)
        return LiveState(
            online=presence.online,
            since=rfc3339(presence.since),
            end_code=presence.end_code,
            address=presence.address,
            rtt_ms=presence.rtt_ms,
            ros=presence.ros,
            video=presence.video,
            drivers=[] if driver is None else [driver],
            observers=self._connections.observers(robot_id),
            agent_version=presence.agent_version,
            battery=presence.battery,
            control=self._control.describe(robot_id),
            recording=self._registry.robot(robot_id).recorders.write,
        )

    def _rtt_changed(self, robot_id: int) -> None:
        now = asyncio.get_running_loop().time()
        robot = self._registry.ensure_robot(robot_id)
        if now - robot.rtt_notified_at >= RTT_NOTIFY_EVERY_S:
            robot.rtt_notified_at = now
            self.changed(robot_id)


def _help_states(requests: Sequence[RelayRequest]) -> dict[int, str]:
    usual = (request for request in requests if request.state in HELP_STATES)
    ordered = sorted(usual, key=lambda request: HELP_STATES.index(request.state))
    return {request.robot_id: request.state for request in ordered}


def _offline_reason(robot: RelayRobot, live: LiveState, version: str | None) -> str | None:
    if live.online:
        return None
    return offline_reason(
        robot.state,
        live.end_code,
        ever_online=live.since is not None,
        other_key=robot.other_key,
        agent_version=version,
    )


class Subscriber(ChangedRobots):
    """What one client has yet to receive."""

    def __init__(self, fleet_events: FleetEvents, user_id: int) -> None:
        super().__init__()
        self._fleet_events = fleet_events
        self.user_id = user_id
        self._objects: dict[int, RobotObject] = {}

    def first_event(self) -> Event:
        """The whole fleet, for the beginning."""
        robots = self._fleet_events.visible(self.user_id)
        self._objects = {robot.id: self._fleet_events.describe(robot) for robot in robots}
        return "fleet", list(self._objects.values())

    def mark(self, robot_id: int) -> None:
        """Remember that a robot changed, if it concerns this client."""
        if robot_id in self._objects or self._fleet_events.find(self.user_id, robot_id) is not None:
            self.add(robot_id)

    def mark_all(self) -> None:
        """Remember that anything may have changed."""
        self.add(*self._objects, *(robot.id for robot in self._fleet_events.visible(self.user_id)))

    def pop_events(self) -> list[Event]:
        """The newest state of each robot that changed; afterwards nothing is pending.

        Names that end come first: another robot may have one of them now.
        """
        robots = {each: self._fleet_events.find(self.user_id, each) for each in self.pop()}
        events: list[Event] = []
        for robot_id, robot in robots.items():
            before = self._objects.get(robot_id)
            if before is not None and (robot is None or robot.name != before.name):
                del self._objects[robot_id]
                events.append(("removed", RemovedRobot(before.name)))
        for robot in filter(None, robots.values()):
            robot_object = self._fleet_events.describe(robot)
            if robot_object != self._objects.get(robot.id):
                self._objects[robot.id] = robot_object
                events.append(("robot", robot_object))
        return events
