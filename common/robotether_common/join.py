"""How a robot that joins proves that it has its key, and the one before: what each signs, by `ssh-keygen -Y`."""

from __future__ import annotations

from dataclasses import dataclass

JOIN_NAMESPACE = "robotether-join"
ROTATION_NAMESPACE = "robotether-rotation"


@dataclass(frozen=True)
class PreviousKey:
    """The key that the robot had until now, and its signature over MAC and new key."""

    fingerprint: str
    signature: str


def join_message(token: str | None, mac: str, public_key: str) -> str:
    """Return what the key that joins signs; `public_key` is its line `ssh-ed25519 AAAA...`."""
    return f"{token or '-'} {mac} {public_key}\n"


def rotation_message(mac: str, public_key: str) -> str:
    """Return what the old key signs; `public_key` is the new one, a line `ssh-ed25519 AAAA...`."""
    return f"{mac} {public_key}\n"
