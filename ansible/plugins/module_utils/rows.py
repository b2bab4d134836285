"""Which of a server's rows is a machine's own, before the row is removed for it.

Used by this role's modules on the controller; pure, and of the standard library only. Name and key count, and what
the machine says of itself does not: a robot in wrong hands could name another robot's MAC, and an admin who retires the
one must never remove the other.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Mapping
from typing import Any


class ForeignRowError(Exception):
    """The server has such a robot, but it is not this machine; the text is a sentence for people."""


def own_row(
    rows: Iterable[Mapping[str, Any]], name: str, mac: str, public_key: str | None
) -> Mapping[str, Any] | None:
    """Return the row that this machine has, None when the server knows neither MAC, name nor key; ForeignRowError.

    An admin may have given the robot another name and another MAC since, but then the row has the machine's key.
    """
    fingerprint = fingerprint_of(public_key or "")

    def has_key(row: Mapping[str, Any]) -> bool:
        return fingerprint is not None and row["fingerprint"] == fingerprint

    matches = [row for row in rows if mac == row["mac"] or name == row["name"] or has_key(row)]
    for row in matches:
        if (row["mac"], row["name"]) == (mac, name) or has_key(row):
            return row
    if matches:
        names = " and ".join(f"{row['name']} (MAC {row['mac']})" for row in matches)
        raise ForeignRowError(
            f"cannot decide which robot {name} is on the server: the machine reports MAC {mac}, the server "
            f"knows {names}, and the key there is not this machine's; check both, and remove the right one by "
            "hand: robotether robot remove NAME"
        )
    return None


def fingerprint_of(public_key: str) -> str | None:
    """Return the SHA-256 of a line `ssh-ed25519 AAAA...` as ssh-keygen prints it; None for another text."""
    words = public_key.split()
    try:
        blob = base64.b64decode(words[1], validate=True)
    except (IndexError, ValueError):
        return None
    return f"SHA256:{base64.b64encode(hashlib.sha256(blob).digest()).decode().rstrip('=')}"
