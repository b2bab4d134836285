"""Finds the MAC address that names this robot on the server.

Asked by the enroller before a join. Reads /sys and /proc only; never changes an interface.
A MAC only names a robot; its key is what proves it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from robotether_agent.problems import InterfaceMissing

ARPHRD_ETHER = 1
RTF_UP = 0x1
SEPARATORS = re.compile(r"[:.\-\s]")
HEX12 = re.compile(r"[0-9a-f]{12}")


class MacError(ValueError):
    """The text is no MAC address that can name a robot; the message says why."""


@dataclass(frozen=True)
class Interface:
    """A physical interface as the kernel shows it."""

    name: str
    mac: str
    index: int
    wireless: bool


def normalise_mac(text: str, *, allow_local: bool = False) -> str:
    """Return `text`, a MAC in any usual spelling, as aa:bb:cc:dd:ee:ff; raise MacError."""
    digits = SEPARATORS.sub("", text).lower()
    if not HEX12.fullmatch(digits):
        raise MacError(f"{text!r} is not a MAC address such as 00:1b:44:11:3a:b7")
    if digits == "0" * 12:
        raise MacError(f"{text} is the zero address")
    first = int(digits[:2], 16)
    if first & 0x01:
        raise MacError(f"{text} is a multicast or broadcast address")
    if first & 0x02 and not allow_local:
        raise MacError(f"{text} is locally administered, so another robot may have it too")
    return ":".join(digits[at : at + 2] for at in range(0, 12, 2))


def find_mac(interface: str | None, *, allow_local: bool, root: Path = Path("/")) -> str:
    """Return the MAC of `interface`, or of the primary physical interface when None."""
    if interface is not None:
        return _named_mac(interface, allow_local=allow_local, root=root)
    chosen = choose(physical_interfaces(root, allow_local=allow_local), default_routes(root))
    if chosen is None:
        raise InterfaceMissing(
            "cannot find the MAC address of this robot: it has no physical network interface with one",
            advice="set interface or mac in agent.toml",
        )
    return chosen.mac


def choose(interfaces: list[Interface], routes: list[str]) -> Interface | None:
    """Return the primary one: with the best default route, else wired, else of the lowest index."""

    def rank(interface: Interface) -> tuple[int, bool, int]:
        name = interface.name
        route = routes.index(name) if name in routes else len(routes)
        return route, interface.wireless, interface.index

    return min(interfaces, key=rank, default=None)


def physical_interfaces(root: Path, *, allow_local: bool) -> list[Interface]:
    """Return the Ethernet-like interfaces that stand for hardware and have a usable MAC."""
    found = []
    for path in sorted((root / "sys/class/net").glob("*")):
        # Only hardware has a `device` link: loopback, docker, veth, bridges, tun and VLANs have none.
        if not (path / "device").exists() or _number(path / "type") != ARPHRD_ETHER:
            continue
        try:
            mac = normalise_mac(_text(path / "address"), allow_local=allow_local)
        except MacError:
            continue
        wireless = (path / "wireless").exists() or (path / "phy80211").exists()
        found.append(Interface(path.name, mac, _number(path / "ifindex"), wireless))
    return found


def default_routes(root: Path) -> list[str]:
    """Return the names of the interfaces with a default route, best first, IPv4 before IPv6."""
    return _ipv4_default_routes(root) + _ipv6_default_routes(root)


def _ipv4_default_routes(root: Path) -> list[str]:
    routes = []
    for line in _text(root / "proc/net/route").splitlines()[1:]:
        name, destination, _, flags, _, _, metric, mask = line.split()[:8]
        if destination == mask == "00000000" and int(flags, 16) & RTF_UP:
            routes.append((int(metric), name))
    return [name for _, name in sorted(routes)]


def _ipv6_default_routes(root: Path) -> list[str]:
    routes = []
    for line in _text(root / "proc/net/ipv6_route").splitlines():
        destination, length, _, _, _, metric, _, _, flags, name = line.split()
        if destination == "0" * 32 and length == "00" and int(flags, 16) & RTF_UP:
            routes.append((int(metric, 16), name))
    return [name for _, name in sorted(routes)]


def _named_mac(interface: str, *, allow_local: bool, root: Path) -> str:
    text = _text(root / "sys/class/net" / interface / "address")
    if not text:
        raise InterfaceMissing(
            f"cannot find the MAC address of this robot: it has no interface {interface}",
            advice="correct interface in agent.toml, or wait until it is there",
        )
    try:
        return normalise_mac(text, allow_local=allow_local)
    except MacError as error:
        raise InterfaceMissing(
            f"cannot use the MAC address of interface {interface}: {error}",
            advice="choose another interface, or set allow_local_mac = true if it is really unique",
        ) from error


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        # Interfaces come and go while they are read, and some have no such attribute.
        return ""


def _number(path: Path) -> int:
    text = _text(path)
    return int(text) if text.isdecimal() else -1
