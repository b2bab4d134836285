"""Finds out whether a service of the robot listens beyond loopback, where anyone in its network reaches it.

Used by health and doctor. ROS's rosbridge listens on all interfaces unless it is told otherwise, and the guard is not
in the way of who comes from there. Reads the kernel's list of listening sockets, so that no service sees a connection.
"""

from __future__ import annotations

import ipaddress
import struct
from pathlib import Path
from urllib.parse import urlsplit

from robotether_agent.files import read_text

# The kernel's lists of TCP sockets, and the state LISTEN in them.
LISTS = ("tcp", "tcp6")
LISTEN = "0A"
PAST_GUARD = "anyone in its own network can drive this robot past the guard"
ADVICE = "start it with address:=127.0.0.1, a parameter of its launch file"


def port_of(url: str) -> int:
    """Return the port of a service's URL."""
    split = urlsplit(url)
    return split.port or (443 if split.scheme in {"https", "wss"} else 80)


def exposed_at(url: str, lists: Path = Path("/proc/net")) -> str:
    """Return the address beyond loopback at which the port of `url` is listened on; empty: none, or not known."""
    port = port_of(url)
    for name in LISTS:
        for line in (read_text(lists / name) or "").splitlines()[1:]:
            _, local, _, state, *_ = line.split()
            words, _, its_port = local.partition(":")
            if state != LISTEN or int(its_port, 16) != port:
                continue
            address = _address(words)
            if not _is_loopback(address):
                return str(address)
    return ""


def _address(words: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """Read an address as the kernel prints it: words of 32 bits in this machine's order."""
    raw = bytes.fromhex(words)
    count = len(raw) // 4
    return ipaddress.ip_address(struct.pack(f"={count}I", *struct.unpack(f">{count}I", raw)))


def _is_loopback(address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> bool:
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return (mapped or address).is_loopback
