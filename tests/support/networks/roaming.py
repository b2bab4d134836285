"""Robots' networks that can be cut and changed: each has two uplinks to a router that drops, with one cloud behind all.

All are network namespaces on this machine (namespaces.py), so it needs root. The routers drop without a word, as a lost
radio link does: nobody hears of it but by silence.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from namespaces import Namespace, ip, make, sweep

UPLINKS = ("wifi", "mobile")
# Before every other rule of a router but that for its own addresses.
FIRST_RULE = ("pref", "1")


class RoamingNetwork:
    """The way between one robot and the cloud; addresses are those for tests of networks (RFC 2544)."""

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
        """Lay the cables, and give the robot its first uplink."""
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
