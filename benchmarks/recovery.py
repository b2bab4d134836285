"""How soon a robot is drivable again after its network or its agent was lost. Used by `bench`; needs root.

Real agents (linked_robot.py), each in a network of its own. All cuts are made side by side.
"""

from __future__ import annotations

import asyncio
import math
import random
import signal
import sys
import time
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import AsyncExitStack, ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from linked_robot import ROS_PORT, Subject, start_site, start_subject
from namespaces import Namespace, ip, make, sweep
from paper.programs import Program
from report import Row, Section, quantiles

UPLINKS = ("wifi", "mobile")
# Before every other rule of a router but that for its own addresses.
FIRST_RULE = ("pref", "1")


class RoamingNetwork:
    """The way between one robot and the cloud, in network namespaces; addresses are those for tests (RFC 2544).

    A robot has two uplinks to a router that drops without a word, as a lost radio link does.
    """

    def __init__(self, number: int, cloud: Namespace, router: Namespace, robot: Namespace) -> None:
        self.server = f"198.18.{3 * number}.2"
        self.robot = robot
        self._number = number
        self._cloud = cloud
        self._router = router
        self._uplink = UPLINKS[0]
        self._host = 2
        self._barred: list[tuple[str, ...]] = []

    def build(self) -> None:
        inside = f"robot{self._number}"
        _lay((self._router, "cloud"), (self._cloud, inside))
        _address(self._router, "cloud", self._gateway("cloud"))
        _address(self._cloud, inside, self.server)
        for uplink in UPLINKS:
            _lay((self.robot, uplink), (self._router, uplink))
            _address(self._router, uplink, self._gateway(uplink))
            _address(self.robot, uplink, self._own(uplink))
            way_back = ("via", self._gateway("cloud"))
            ip("-n", self._cloud.name, "route", "add", self._network(uplink), *way_back)
        self._router.sysctl("net.ipv4.ip_forward", "1")
        self._route()

    def cut(self) -> None:
        self._rule("add", *FIRST_RULE, "blackhole")

    def mend(self) -> None:
        self._rule("del", *FIRST_RULE)

    def readdress(self) -> None:
        """Take the robot's address and give it another one, as a new lease of DHCP may."""
        ip("-n", self.robot.name, "address", "flush", "dev", self._uplink)
        self._host = 5 - self._host
        _address(self.robot, self._uplink, self._own(self._uplink))
        self._route()

    def roam(self) -> None:
        """Move the default route to the other uplink; the one before leads nowhere from then on."""
        before = self._uplink
        [self._uplink] = [uplink for uplink in UPLINKS if uplink != before]
        for rule in self._barred:
            self._rule("del", *rule)
        self._barred = [
            ("pref", "2", "iif", before, "blackhole"),
            ("pref", "3", "to", self._network(before), "blackhole"),
        ]
        for rule in self._barred:
            self._rule("add", *rule)
        self._route()

    def _rule(self, *words: str) -> None:
        ip("-n", self._router.name, "rule", *words)

    def _route(self) -> None:
        where = ("via", self._gateway(self._uplink), "dev", self._uplink)
        ip("-n", self.robot.name, "route", "replace", "default", *where)

    def _network(self, cable: str) -> str:
        return f"{self._prefix(cable)}.0/24"

    def _gateway(self, cable: str) -> str:
        return f"{self._prefix(cable)}.1"

    def _own(self, uplink: str) -> str:
        return f"{self._prefix(uplink)}.{self._host}"

    def _prefix(self, cable: str) -> str:
        return f"198.18.{3 * self._number + ('cloud', *UPLINKS).index(cable)}"


@contextmanager
def roaming_networks(how_many: int) -> Iterator[tuple[Namespace, list[RoamingNetwork]]]:
    sweep()
    with ExitStack() as made:
        cloud = make(made, "cloud")
        networks = [
            RoamingNetwork(number, cloud, make(made, "router"), make(made, "robot"))
            for number in range(how_many)
        ]
        for network in networks:
            network.build()
        yield cloud, networks


def _lay(item: tuple[Namespace, str], other: tuple[Namespace, str]) -> None:
    peer = ("peer", "name", other[1], "netns", other[0].name)
    ip("-n", item[0].name, "link", "add", "name", item[1], "type", "veth", *peer)
    for namespace, name in (item, other):
        ip("-n", namespace.name, "link", "set", name, "up")


def _address(namespace: Namespace, name: str, address: str) -> None:
    ip("-n", namespace.name, "address", "add", f"{address}/24", "dev", name)


REPEAT = 50
AIM_S = 2.0
# Nobody waits longer: it counts as a failure.
GIVE_UP_S = 30.0


# Loses the robot, and returns the moment in which it had a network again.
Make = Callable[[Subject, RoamingNetwork], Awaitable[float]]


@dataclass
class Cut:
    """One way to lose a robot, and how long it took each time until it was drivable."""

    name: str
    make: Make
    took_s: list[float] = field(default_factory=list)

    @property
    def row(self) -> Row:
        """A failure is a time at which it was not drivable; it is in no percentile."""
        good = [value for value in self.took_s if math.isfinite(value)]
        failures = len(self.took_s) - len(good)
        return {"after": self.name, **quantiles(good, 0.5, 0.99, 1), "failures": failures}


def with_network(*steps: Callable[[RoamingNetwork], None], for_s: float = 0.0) -> Make:

    async def make(_: Subject, network: RoamingNetwork) -> float:
        for number, step in enumerate(steps):
            await asyncio.sleep(for_s * (number > 0))
            await asyncio.to_thread(step, network)
        return time.monotonic()

    return make


async def frozen(subject: Subject, _: RoamingNetwork) -> float:
    subject.signal_agent(signal.SIGSTOP)
    await asyncio.sleep(10)
    subject.signal_agent(signal.SIGCONT)
    return time.monotonic()


async def rebooted(subject: Subject, _: RoamingNetwork) -> float:
    await asyncio.to_thread(subject.kill_agent)
    at_s = time.monotonic()
    subject.start_agent()
    return at_s


def cuts() -> list[Cut]:
    return [
        *(
            Cut(
                f"packets dropped for {seconds} s",
                with_network(RoamingNetwork.cut, RoamingNetwork.mend, for_s=seconds),
            )
            for seconds in (3, 10, 20)
        ),
        Cut("another address", with_network(RoamingNetwork.readdress)),
        # The one before is gone.
        Cut("default route to another network", with_network(RoamingNetwork.roam)),
        Cut("agent frozen for 10 s", frozen),
        Cut("agent killed and started, as by a reboot", rebooted),
    ]


async def measure_all(networks: Sequence[RoamingNetwork], repeat: int) -> list[Cut]:
    """Make each cut `repeat` times; this thread must be in the cloud's namespace."""
    made = cuts()
    async with AsyncExitStack() as stack:
        site, robots = await start_site(stack, len(networks), "0.0.0.0")
        subjects = []
        for network, robot in zip(networks, robots, strict=True):
            log = Path(stack.enter_context(TemporaryDirectory(prefix="rt-ros-"))) / "log"
            words = ("paper.bus_robot", "127.0.0.1", str(ROS_PORT))
            stack.callback(Program(network.robot, words, log, {}).end)
            started = await start_subject(stack, site, network.server, network.robot, robot)
            subjects.append(started)
        await asyncio.gather(
            *(_measure(*each, repeat) for each in zip(made, subjects, networks, strict=True))
        )
    return made


async def _measure(cut: Cut, subject: Subject, network: RoamingNetwork, repeat: int) -> None:
    rng = random.Random(cut.name)
    for _ in range(repeat):
        await subject.until_drivable()
        # Cuts come at any moment of a heartbeat, and mostly to connections that stood for a while.
        await asyncio.sleep(rng.uniform(1, 2))
        since = await cut.make(subject, network)
        cut.took_s.append(await subject.drivable_after(since, GIVE_UP_S))
        sys.stderr.write(f"{cut.name}: {cut.took_s[-1]:.2f} s\n")
        if cut.took_s[-1] > AIM_S:
            sys.stderr.write(subject.log_tail() + "\n")


def measure(repeat: int = REPEAT) -> Section:
    with roaming_networks(len(cuts())) as (cloud, networks), cloud.entered():
        made = asyncio.run(measure_all(networks, repeat))
    return Section(
        title="How soon a robot is drivable again",
        text="Seconds from when the robot has a network again until a new drive connection through the relay has "
        f"passed a message and its answer, {repeat} times each. All rows run at once, on one machine with network "
        "namespaces. A reboot is a kill and a start of the agent and of all that it started, without the machine's "
        f"boot.\n\nAim: {AIM_S:g} s at p99 and no failure.",
        rows=[cut.row for cut in made],
    )
