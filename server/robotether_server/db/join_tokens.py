"""Join tokens, which admit robots: how many, until when, and where the robots belong. Written by services."""

import datetime as dt
from dataclasses import dataclass

from robotether_server.db import credentials
from robotether_server.db.database import Transaction, unique
from robotether_server.db.grants import GROUPS, SITES
from robotether_server.problems import RecordMissingError
from robotether_server.schemas import Label, Timestamp

SELECT = "SELECT id, name, uses, used, created_at, created_by, expires_at FROM join_tokens "
PREFIX = "rj_"


@dataclass(frozen=True)
class JoinToken:
    """A join token without its text, which only its creator knows."""

    id: int
    name: Label
    uses: int
    used: int
    created_at: Timestamp
    created_by: str
    expires_at: Timestamp


@dataclass(frozen=True)
class Place:
    """Where robots that a token admits belong: at a site, driven by a group of users, in a region; None: in none."""

    site: str | None = None
    group: str | None = None
    region: str | None = None


NOWHERE = Place()


def create(
    tx: Transaction,
    name: str,
    uses: int,
    expires_at: dt.datetime,
    by: str,
    *,
    place: Place = NOWHERE,
    api_token: bytes | None = None,
) -> str:
    """Make a token; return its text, which cannot be had again. Raises RecordExistsError or RecordMissingError.

    `api_token` is the hash of the one that made it.
    """
    site_id = SITES.get(tx, place.site).id if place.site else None
    group_id = GROUPS.get(tx, place.group).id if place.group else None
    text = credentials.new_secret(PREFIX)
    with unique(
        f"cannot create join token {name}: there is one of that name; delete it or choose another name"
    ):
        tx.insert(
            "INSERT INTO join_tokens (name, token_hash, uses, expires_at, created_by, site_id, group_id, "
            "region, api_token_id) VALUES (%s, %s, %s, %s, %s, %s, %s, %s, "
            "(SELECT id FROM api_tokens WHERE token_hash = %s))",
            (
                name,
                credentials.digest(text),
                uses,
                expires_at,
                by,
                site_id,
                group_id,
                place.region,
                api_token,
            ),
        )
    return text


def find(tx: Transaction, text: str) -> JoinToken | None:
    """Return the token of that text, be it used up or over."""
    row = tx.row(SELECT + "WHERE token_hash = %s", (credentials.digest(text),))
    return JoinToken(**row) if row else None


def get(tx: Transaction, token_id: int) -> JoinToken:
    """Return the token of that id, locked until the transaction ends; raise RecordMissingError."""
    row = tx.row(SELECT + "WHERE id = %s FOR UPDATE", (token_id,))
    if row is None:
        raise RecordMissingError(f"cannot find join token {token_id}: there is none of that number")
    return JoinToken(**row)


def list_all(tx: Transaction) -> list[JoinToken]:
    """Return every join token, the newest first."""
    return [JoinToken(**row) for row in tx.rows(SELECT + "ORDER BY id DESC")]


def made_by(tx: Transaction, api_token_id: int) -> list[int]:
    """Return the ids of those that an API token made."""
    rows = tx.rows("SELECT id FROM join_tokens WHERE api_token_id = %s", (api_token_id,))
    return [row["id"] for row in rows]


def place_of(tx: Transaction, token_id: int) -> Place:
    """Return where the robots that a token admits belong."""
    row = tx.row(
        "SELECT s.name AS site, g.name AS `group`, t.region FROM join_tokens t "
        "LEFT JOIN sites s ON s.id = t.site_id LEFT JOIN user_groups g ON g.id = t.group_id "
        "WHERE t.id = %s",
        (token_id,),
    )
    return Place(**row) if row else NOWHERE


def names_for(tx: Transaction, place: Place) -> list[str]:
    """Return the names of the tokens that can still admit robots to this site or for this group."""
    rows = tx.rows(
        "SELECT t.name FROM join_tokens t "
        "LEFT JOIN sites s ON s.id = t.site_id LEFT JOIN user_groups g ON g.id = t.group_id "
        "WHERE (s.name = %s OR g.name = %s) AND t.used < t.uses "
        "AND t.expires_at > CURRENT_TIMESTAMP(6) ORDER BY t.name",
        (place.site, place.group),
    )
    return [row["name"] for row in rows]


def admitted(tx: Transaction, token_id: int) -> set[str]:
    """Return the fingerprints of the keys that a token has admitted."""
    rows = tx.rows("SELECT fingerprint FROM join_token_uses WHERE token_id = %s", (token_id,))
    return {row["fingerprint"] for row in rows}


def has_admitted(tx: Transaction, token_id: int, fingerprint: str) -> bool:
    """Return whether this token has admitted that key before."""
    row = tx.row(
        "SELECT 1 FROM join_token_uses WHERE token_id = %s AND fingerprint = %s",
        (token_id, fingerprint),
    )
    return row is not None


def use(tx: Transaction, token_id: int, fingerprint: str) -> bool:
    """Count one use, for that key; return False when none is left, its time is over or it is deleted."""
    counted = tx.change(
        "UPDATE join_tokens SET used = used + 1 "
        "WHERE id = %s AND used < uses AND expires_at > CURRENT_TIMESTAMP(6)",
        (token_id,),
    )
    if not counted:
        return False
    tx.change(
        "INSERT INTO join_token_uses (token_id, fingerprint) VALUES (%s, %s)",
        (token_id, fingerprint),
    )
    return True


def delete(tx: Transaction, token_id: int) -> None:
    """Delete a token; the robots that it admitted stay."""
    tx.change("DELETE FROM join_tokens WHERE id = %s", (token_id,))
