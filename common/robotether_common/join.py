"""How a robot that joins with a new key proves that it had the old one: what the old key signs, by `ssh-keygen -Y`."""

from __future__ import annotations

from dataclasses import dataclass

ROTATION_NAMESPACE = "robotether-rotation"


@dataclass(frozen=True)
class PreviousKey:
    """The key that the robot had until now, and its signature over MAC and new key."""

    fingerprint: str
    signature: str


def rotation_message(mac: str, public_key: str) -> str:
    """Return what the old key signs; `public_key` is the new one, a line `ssh-ed25519 AAAA...`."""
    return f"{mac} {public_key}\n"
