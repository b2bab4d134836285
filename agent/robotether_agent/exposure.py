"""Finds services of the robot that answer its own network, past the guard, and what would confine them.

Used by the agent's health and doctor. It believes what answers and not what was configured: rosbridge 0.11 for ROS 1
prints the address of its settings and listens on all interfaces.
"""

from __future__ import annotations

import asyncio
import base64
import fcntl
import ipaddress
import logging
import os
import socket
import struct
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

import aiohttp

from robotether_agent.files import MACHINE_FAULTS, read_text
from robotether_agent.problems import StateUnusableError

# A firewall that spares this machine's own connections, as ufw does, does not show from here.
UNLESS_FIREWALL = "unless a firewall keeps them out"
PAST_GUARD = f"anyone in its own network can drive this robot past the guard, {UNLESS_FIREWALL}"
ADDRESS_ADVICE = "start it with address:=127.0.0.1, a parameter of its launch file"
# rosbridge from 0.11.5 on for ROS 1 is built on Autobahn and passes no address to it.
FIREWALL_ADVICE = "this rosbridge of ROS 1 ignores address:=127.0.0.1; close its port as docs/howto/ros1-robot.md says"
FIREWALLED = "AutobahnPython"
TIMEOUT_S = 1.0
DEFAULT_PORTS = {"https": 443, "wss": 443, "rtsp": 554}
# The kernel's lists of TCP sockets beside that of IPv6 addresses, and the state LISTEN in them.
LISTS = Path("/proc/self/net")
TCP_LISTS = ("tcp", "tcp6")
LISTEN = "0A"
# Request number for an interface's address (linux/sockios.h); a struct ifreq begins with its name,
# in 16 bytes.
SIOCGIFADDR = 0x8915
IFREQ = struct.Struct("16s2xH4s16x")

log = logging.getLogger(__name__)

Address = ipaddress.IPv4Address | ipaddress.IPv6Address


def port_of(url: str) -> int:
    """Return the port of a service's URL."""
    split = urlsplit(url)
    return split.port or DEFAULT_PORTS.get(split.scheme, 80)


def exposed_at(url: str) -> str | None:
    """Return an address beyond loopback at which the port of `url` answers; empty: none; None: it is not known.

    Blocks for TIMEOUT_S for each of the robot's own addresses at most. A service that listens on loopback alone sees no
    connection: the kernel's list says so. One that listens on all interfaces is tried at the robot's own addresses,
    where a firewall may be in the way, if it is one for connections of this machine, too.
    """
    try:
        return _exposed_at(port_of(url))
    except (OSError, StateUnusableError) as error:
        # A hardened kernel shows its list to root alone; and this process may have no free file descriptor.
        log.debug("cannot see whether %s is exposed: %s", url, error)
        return None


def _exposed_at(port: int) -> str:
    for address in _listens_beyond_loopback(port):
        candidates = [str(address)]
        if address.is_unspecified:
            candidates = own_addresses()
            if isinstance(address, ipaddress.IPv6Address):
                candidates += own_ipv6_addresses()
        if not candidates:
            # Nobody is in the robot's network now; that may change.
            return str(address)
        for candidate in candidates:
            if _answers(candidate, port):
                return candidate
    return ""


def own_addresses() -> list[str]:
    """Return the IPv4 addresses of this machine's network interfaces, without loopback."""
    addresses = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        for _, name in socket.if_nameindex():
            request = IFREQ.pack(name.encode(), 0, b"")
            # An interface without an address has none to tell.
            with suppress(OSError):
                raw = IFREQ.unpack(fcntl.ioctl(asking, SIOCGIFADDR, request)[: IFREQ.size])[2]
                addresses.append(ipaddress.ip_address(raw))
    return [str(address) for address in addresses if not address.is_loopback]


def own_ipv6_addresses() -> list[str]:
    """Return the IPv6 addresses of this machine's network interfaces, without loopback."""
    addresses = []
    for line in _lines_of(LISTS / "if_inet6"):
        digits, *_, name = line.split()
        address = ipaddress.IPv6Address(bytes.fromhex(digits))
        if not address.is_loopback:
            # The same one may be on several links.
            addresses.append(f"{address}%{name}" if address.is_link_local else str(address))
    return addresses


async def rosbridge_advice(url: str) -> str:
    """Return what confines the rosbridge at `url` to this machine, by which server it says to be."""
    key = base64.b64encode(os.urandom(16)).decode()
    headers = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": key,
    }
    timeout = aiohttp.ClientTimeout(total=TIMEOUT_S)
    try:
        async with (
            aiohttp.ClientSession(timeout=timeout) as http,
            http.get(
                url.replace("ws", "http", 1), headers=headers, allow_redirects=False
            ) as answer,
        ):
            server = answer.headers.get("Server", "")
    except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
        log.debug("cannot ask %s which server it is: %r", url, error)
        return f"{ADDRESS_ADVICE}; on ROS 1: close its port as docs/howto/ros1-robot.md says"
    return FIREWALL_ADVICE if server.startswith(FIREWALLED) else ADDRESS_ADVICE


def _answers(address: str, port: int) -> bool:
    try:
        socket.create_connection((address, port), timeout=TIMEOUT_S).close()
    except OSError as error:
        if error.errno in MACHINE_FAULTS:
            raise
        return False
    return True


def _listens_beyond_loopback(port: int) -> list[Address]:
    addresses = []
    for name in TCP_LISTS:
        for line in _lines_of(LISTS / name)[1:]:
            _, local, _, state, *_ = line.split()
            words, _, its_port = local.partition(":")
            if state == LISTEN and int(its_port, 16) == port:
                addresses.append(_address(words))
    return [address for address in addresses if not _is_loopback(address)]


def _lines_of(path: Path) -> list[str]:
    return (read_text(path) or "").splitlines()


def _address(words: str) -> Address:
    """Read an address as the kernel prints it: words of 32 bits in this machine's order."""
    raw = bytes.fromhex(words)
    count = len(raw) // 4
    return ipaddress.ip_address(struct.pack(f"={count}I", *struct.unpack(f">{count}I", raw)))


def _is_loopback(address: Address) -> bool:
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return (mapped or address).is_loopback
