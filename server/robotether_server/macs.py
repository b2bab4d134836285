"""Writes a MAC address in one spelling, `00:1b:44:11:3a:b7`, and rejects those that no robot has.

Used by services before they ask the database. Twin of the procedure normalise_mac in
sql/0006_shell_ports_and_macs.sql, which serves whoever writes SQL by hand; a test holds the two together.
"""

import re

from robotether_server.problems import FieldInvalid

MAX_TEXT_LENGTH = 40
ZERO = "00:00:00:00:00:00"
# Bits of the first byte: for many machines at once, and given by a machine to itself (IEEE 802).
MULTICAST = 0x01
LOCAL = 0x02

_SPELLINGS = re.compile(
    r"([0-9a-f]{1,2}:){5}[0-9a-f]{1,2}"  # some systems print 0 for 00
    r"|([0-9a-f]{1,2}-){5}[0-9a-f]{1,2}"
    r"|([0-9a-f]{4}[.]){2}[0-9a-f]{4}"
    r"|[0-9a-f]{12}"
)


def normalise(text: str, *, allow_local: bool = True) -> str:
    """Return the MAC in lower case with colons; raise FieldInvalid when it is none that a robot may have."""
    lower = text.strip(" ").lower()
    if not _SPELLINGS.fullmatch(lower):
        raise FieldInvalid(
            f"cannot use mac {text[:MAX_TEXT_LENGTH]!r}: it is no MAC address; write it as 00:1b:44:11:3a:b7",
            "mac",
        )
    digits = "".join(part.zfill(2) for part in re.split("[:.-]", lower))
    mac = ":".join(digits[at : at + 2] for at in range(0, len(digits), 2))
    if mac == ZERO or _first_byte(mac) & MULTICAST:
        raise FieldInvalid(
            f"cannot use mac {text[:MAX_TEXT_LENGTH]!r}: it is all zero, broadcast or multicast, which no single "
            "robot has; give that of its network card",
            "mac",
        )
    if not allow_local:
        check_universal(mac)
    return mac


def check_universal(mac: str) -> None:
    """Raise FieldInvalid for a MAC that a machine gave itself: another may have given itself the same."""
    if _first_byte(mac) & LOCAL:
        raise FieldInvalid(
            f"cannot use mac {mac}: it is locally administered, as those of virtual machines and containers "
            "are; give that of a network card, or let an admin announce this one: "
            "robotether robot add NAME --mac MAC --allow-local-mac",
            "mac",
        )


def _first_byte(mac: str) -> int:
    return int(mac[:2], 16)
