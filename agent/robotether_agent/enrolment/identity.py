"""Finds the MAC address that names this robot, once, and then keeps it, whatever interfaces come and go.

Used by the enroller and by `robotether-agent identity`. The settings `mac` and `interface` win; else the
address that was found first stays, so that a robot never becomes another one by itself. Reads /sys and /proc;
never changes an interface. A MAC only names a robot; its key is what proves it.
"""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from robotether_agent.fields import (
    MAC,
    FieldError,
    MacError,
    get_match,
    get_text,
    normalise_mac,
    parse_object,
)
from robotether_agent.files import read_text, write_atomic
from robotether_agent.problems import InterfaceMissingError, StateUnusableError

if TYPE_CHECKING:
    # join.sh uses this module before anything is installed, and settings need a package on Python 3.10.
    from robotether_agent.settings import Settings

ARPHRD_ETHER = 1
RTF_UP = 0x1
# What gives the address that the hardware came with: a bond gives its members its own address, and a
# Wi-Fi that looks for networks may show a made-up one.
ADDRESSES = ("bonding_slave/perm_hwaddr", "phy80211/macaddress", "address")
IDENTITY_FILE = "identity.json"

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Interface:
    """An interface as the kernel shows it."""

    name: str
    mac: str
    index: int
    wireless: bool


@dataclass(frozen=True)
class Identity:
    """The MAC that names this robot, and the interface that has it, or had it when `is_present` is False."""

    mac: str
    interface: str
    is_present: bool = True


class IdentityStore:
    """The file in `state_dir` that keeps what was found first."""

    def __init__(self, settings: Settings, root: Path, *, keeps: bool = True) -> None:
        self._settings = settings
        self._root = root
        self._keeps = keeps
        self._file = settings.state_dir / IDENTITY_FILE

    def identity(self, enrolled_mac: str | None = None) -> Identity:
        """Return who this robot is; `enrolled_mac` replaces a file that could not be written or is lost."""
        settings = self._settings
        if settings.mac is not None:
            # A person said so; in a container no interface may have it.
            return Identity(settings.mac, interface_with(settings.mac, self._root))
        identity = self._read() or self._adopted(enrolled_mac)
        if identity is None:
            return self._keep(self._find())
        if settings.interface not in {None, identity.interface}:
            return self._moved(identity)
        return self._as_it_is_now(identity)

    def is_kept(self, identity: Identity) -> bool:
        """Return whether `identity` will be the same after a restart."""
        record = self._read()
        return self._settings.mac is not None or (record is not None and record.mac == identity.mac)

    def _find(self) -> Interface:
        settings = self._settings
        return find_interface(
            settings.interface, allow_local=settings.allow_local_mac, root=self._root
        )

    def _moved(self, identity: Identity) -> Identity:
        """Follow the setting `interface` to another one, as soon as that is there."""
        try:
            return self._keep(self._find())
        except InterfaceMissingError:
            return self._as_it_is_now(identity)

    def _as_it_is_now(self, identity: Identity) -> Identity:
        now = interface_with(identity.mac, self._root)
        return Identity(identity.mac, now or identity.interface, bool(now))

    def _adopted(self, enrolled_mac: str | None) -> Identity | None:
        if enrolled_mac is None:
            return None
        has_it = interface_with(enrolled_mac, self._root) or self._settings.interface or ""
        self._write(enrolled_mac, has_it)
        return Identity(enrolled_mac, has_it)

    def _keep(self, interface: Interface) -> Identity:
        self._write(interface.mac, interface.name)
        return Identity(interface.mac, interface.name)

    def _write(self, mac: str, interface: str) -> None:
        text = json.dumps({"interface": interface, "mac": mac}) + "\n"
        try:
            if self._keeps and read_text(self._file) != text:
                write_atomic(self._file, text, 0o644)
        except StateUnusableError as problem:
            # An enrolled robot has its MAC in the enrolment too, and a fresh one needs the disk for its key.
            log.debug("%s", problem)

    def _read(self) -> Identity | None:
        try:
            obj = parse_object(read_text(self._file) or "", IDENTITY_FILE)
            mac = get_match(obj, "mac", MAC, "a MAC address")
            return Identity(mac, get_text(obj, "interface"))
        except FieldError:
            return None


def find_interface(
    interface: str | None, *, allow_local: bool, root: Path = Path("/")
) -> Interface:
    """Return `interface`, or the primary physical interface when None; raise InterfaceMissingError."""
    if interface is not None:
        return _named(interface, allow_local=allow_local, root=root)
    # Best first, IPv4 before IPv6.
    routes = _ipv4_default_routes(root) + _ipv6_default_routes(root)
    chosen = choose(physical_interfaces(root, allow_local=allow_local), routes)
    if chosen is None and (local := choose(physical_interfaces(root, allow_local=True), routes)):
        return _named(local.name, allow_local=allow_local, root=root)
    if chosen is None:
        raise InterfaceMissingError(
            "cannot find the MAC address of this robot: it has no physical network interface with one",
            advice="set interface or mac in agent.toml, and allow_local_mac = true in a container",
        )
    return chosen


def interface_with(mac: str, root: Path) -> str:
    """Return the name of an interface that has `mac` now, hardware first, or "" when none has it."""
    paths = [path for path in _interfaces(root) if mac in _all_macs(path)]
    # VLANs, bridges and bonds have the address of the hardware below them.
    paths.sort(key=lambda path: (not _is_hardware(path), _number(path / "ifindex")))
    return paths[0].name if paths else ""


def choose(interfaces: list[Interface], routes: list[str]) -> Interface | None:
    """Return the primary one: with the best default route, else wired, else of the lowest index."""

    def rank(interface: Interface) -> tuple[int, bool, int]:
        name = interface.name
        route = routes.index(name) if name in routes else len(routes)
        return route, interface.wireless, interface.index

    return min(interfaces, key=rank, default=None)


def physical_interfaces(root: Path, *, allow_local: bool) -> list[Interface]:
    """Return the Ethernet-like interfaces that are hardware and have a usable MAC."""
    interfaces = []
    for path in _interfaces(root):
        if not _is_hardware(path) or _number(path / "type") != ARPHRD_ETHER:
            continue
        try:
            interfaces.append(_interface(path, allow_local=allow_local))
        except MacError:
            continue
    return interfaces


def _ipv4_default_routes(root: Path) -> list[str]:
    routes = []
    for line in _text(root / "proc/self/net/route").splitlines()[1:]:
        name, destination, _, flags, _, _, metric, mask = line.split()[:8]
        if destination == mask == "00000000" and int(flags, 16) & RTF_UP:
            routes.append((int(metric), name))
    return [name for _, name in sorted(routes)]


def _ipv6_default_routes(root: Path) -> list[str]:
    routes = []
    for line in _text(root / "proc/self/net/ipv6_route").splitlines():
        destination, length, _, _, _, metric, _, _, flags, name = line.split()
        if destination == "0" * 32 and length == "00" and int(flags, 16) & RTF_UP:
            routes.append((int(metric, 16), name))
    return [name for _, name in sorted(routes)]


def _named(interface: str, *, allow_local: bool, root: Path) -> Interface:
    path = root / "sys/class/net" / interface
    if not _mac_text(path):
        raise InterfaceMissingError(
            f"cannot find the MAC address of this robot: it has no interface {interface}",
            advice="correct interface in agent.toml, or wait until it is there",
        )
    try:
        return _interface(path, allow_local=allow_local)
    except MacError as error:
        raise InterfaceMissingError(
            f"cannot use the MAC address of interface {interface}: {error}",
            advice="choose another interface, or set allow_local_mac = true if it is really unique",
        ) from error


def _interfaces(root: Path) -> list[Path]:
    return sorted((root / "sys/class/net").glob("*"))


def _interface(path: Path, *, allow_local: bool) -> Interface:
    mac = normalise_mac(_mac_text(path), allow_local=allow_local)
    wireless = (path / "wireless").exists() or (path / "phy80211").exists()
    return Interface(path.name, mac, _number(path / "ifindex"), wireless)


def _is_hardware(path: Path) -> bool:
    # Loopback, docker, veth, bridges, bonds, tun and VLANs have no such link.
    return (path / "device").exists()


def _mac_text(path: Path) -> str:
    """Return the address that the hardware came with, or else the one that it has now."""
    texts = (_text(path / name) for name in ADDRESSES)
    return next((text for text in texts if text.strip("0:")), "")


def _all_macs(path: Path) -> set[str]:
    return {_text(path / name).lower() for name in ADDRESSES}


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        # Interfaces come and go while they are read, and some have no such attribute.
        return ""


def _number(path: Path) -> int:
    text = _text(path)
    return int(text) if text.isdecimal() else -1
