"""The audit log: who changed what, and who was refused. Entries are only added; the database prunes old ones.

Written by web and cli in the transaction of the change itself. Never holds a secret.
"""

import datetime as dt
import json
from collections.abc import Collection
from dataclasses import dataclass, field
from ipaddress import IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network

from robotether_server.contract.audit import AUDIT_KINDS, AuditEvent
from robotether_server.db.database import Transaction
from robotether_server.problems import FieldInvalidError

MAX_ACTOR_LENGTH = 63
MAX_ADDRESS_LENGTH = 45

# One customer holds a whole /64 of IPv6, so for limits its addresses count as one.
Network = IPv4Network | IPv6Network
IPV6_PREFIX = 64
NOBODYS = ip_network("::")


@dataclass(frozen=True)
class Source:
    """The author of a change: a user's name or `cli`, and an IP address; `api_token`: its hash, if one was shown."""

    actor: str
    address: str | None = None
    api_token: bytes | None = field(default=None, repr=False)


@dataclass(frozen=True)
class AuditSearch:
    """A filter of events: all given members must match."""

    robot: str | None = None
    actor: str | None = None
    kind: str | None = None
    since: dt.datetime | None = None
    until: dt.datetime | None = None


@dataclass(frozen=True)
class Occurrence:
    """One event that was found: what, whose, when; `id` is None where the log does not have it yet."""

    kind: str
    actor: str
    at: dt.datetime
    id: int | None = None


def record(
    tx: Transaction,
    source: Source,
    kind: str,
    robot: str | None = None,
    at: dt.datetime | None = None,
    /,
    **details: object,
) -> int:
    """Add one event, as of now or of another time, and return its id.

    `kind` is a short code; there may be a robot's name, and details that JSON can hold.
    """
    values = {
        "actor": source.actor[:MAX_ACTOR_LENGTH],
        "kind": kind,
        "robot": robot,
        "address": source.address and source.address[:MAX_ADDRESS_LENGTH],
        "details": json.dumps(details),
    }
    return tx.add("audit_events", values if at is None else values | {"at": at})


def count_refused_keys(tx: Transaction) -> int:
    """Return how many keys of strangers the lines of the last hour count; see `record_refused_key` in sql/0018."""
    row = tx.row(
        """SELECT COUNT(*) + IFNULL(SUM(IFNULL(JSON_VALUE(details, '$.more'), 0)
        + IFNULL(JSON_VALUE(details, '$.elsewhere'), 0)), 0) AS times
        FROM audit_events WHERE kind = 'key_refused' AND at > CURRENT_TIMESTAMP(6) - INTERVAL 1 HOUR"""
    )
    return int(row["times"]) if row is not None else 0


def network_of(address: str) -> Network:
    """Return the network that an address counts for; texts that are no address count for one, too."""
    try:
        parsed = ip_address(address)
    except ValueError:
        return NOBODYS
    # An IPv4 address in IPv6 spelling: a /64 would throw all of them together.
    if isinstance(parsed, IPv6Address) and parsed.ipv4_mapped is None:
        return ip_network((parsed, IPV6_PREFIX), strict=False)
    return ip_network(parsed)


def find(
    tx: Transaction,
    search: AuditSearch = AuditSearch(),
    *,
    before: int | None = None,
    limit: int = 100,
) -> list[AuditEvent]:
    """Return the matching events, newest first; `before` is the id to continue from.

    Raises FieldInvalidError for a kind that neither this version nor the log has.
    """
    values = {
        "robot = %s": search.robot,
        "actor = %s": search.actor,
        "kind = %s": search.kind,
        "at >= %s": search.since,
        "at < %s": search.until,
        "id < %s": before,
    }
    parameters = {condition: value for condition, value in values.items() if value is not None}
    rows = tx.rows(
        "SELECT id, at, actor, kind, robot, address, details FROM audit_events WHERE "  # noqa: S608 - the conditions are the module's own
        + " AND ".join(("TRUE", *parameters))
        + " ORDER BY id DESC LIMIT %s",
        (*parameters.values(), limit),
    )
    if not rows and before is None and search.kind not in {None, *AUDIT_KINDS}:
        raise FieldInvalidError(
            f"cannot find events of kind {search.kind!r}: there is no such kind; the filter of /admin/audit lists all",
            "kind",
        )
    return [AuditEvent(**row | {"details": json.loads(row["details"])}) for row in rows]


def recent_from(
    tx: Transaction, kinds: Collection[str], network: Network, since: dt.datetime
) -> list[Occurrence]:
    """Return the events of these kinds that came from one network, the oldest first."""
    rows = tx.rows(
        "SELECT kind, actor, at, id FROM audit_events WHERE kind IN %s AND at > %s "
        "AND INET6_ATON(address) BETWEEN %s AND %s ORDER BY at, id",
        (tuple(kinds), since, *_bounds(network)),
    )
    return [Occurrence(**row) for row in rows]


def recent_of(tx: Transaction, kind: str, actor: str, since: dt.datetime) -> list[Occurrence]:
    """Return one actor's events of one kind, from anywhere, the oldest first."""
    rows = tx.rows(
        "SELECT kind, actor, at, id FROM audit_events "
        "WHERE actor = %s AND kind = %s AND at > %s ORDER BY at",
        (actor, kind, since),
    )
    return [Occurrence(**row) for row in rows]


def has_come_from(tx: Transaction, kind: str, actor: str, network: Network) -> bool:
    """Return whether the log has an event of that kind and user from that network.

    Those of a removed user of the same name do not count.
    """
    row = tx.row(
        "SELECT 1 FROM audit_events e JOIN users u ON u.name = e.actor AND e.at >= u.created_at "
        "WHERE e.actor = %s AND e.kind = %s AND INET6_ATON(e.address) BETWEEN %s AND %s LIMIT 1",
        (actor, kind, *_bounds(network)),
    )
    return row is not None


def _bounds(network: Network) -> tuple[bytes, bytes]:
    """Return the first and the last address as INET6_ATON has them: 4 bytes are IPv4, 16 are IPv6."""
    return network[0].packed, network[-1].packed
