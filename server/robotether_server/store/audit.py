"""The audit log: who changed what, who was refused. Only ever added to.

Written by web and cli in the transaction of the change that it tells of. Never holds a secret.
"""

import datetime as dt
import json
from dataclasses import dataclass, field

from robotether_server.store.database import Transaction

LONGEST_ACTOR = 63


@dataclass(frozen=True)
class Source:
    """Who does something, and from where: a user's name or `cli`, and an IP address."""

    actor: str
    address: str | None = None


@dataclass(frozen=True)
class Event:
    """What happened: a short code, perhaps a robot's name, and details that JSON can hold."""

    kind: str
    robot: str | None = None
    details: dict[str, object] = field(default_factory=dict)


def record(tx: Transaction, source: Source, event: Event) -> None:
    """Add one event, as of now."""
    tx.insert(
        "INSERT INTO audit_events (actor, kind, robot, address, details) "
        "VALUES (%s, %s, %s, %s, %s)",
        (
            source.actor[:LONGEST_ACTOR],
            event.kind,
            event.robot,
            source.address,
            json.dumps(event.details),
        ),
    )


def recent_moments(
    tx: Transaction, kind: str, address: str, since: dt.datetime
) -> list[tuple[str, dt.datetime]]:
    """Return actor and moment of the events of one kind from one address, the oldest first."""
    rows = tx.rows(
        "SELECT actor, at FROM audit_events WHERE kind = %s AND address = %s AND at > %s ORDER BY at",
        (kind, address, since),
    )
    return [(row["actor"], row["at"]) for row in rows]
