"""The chains of the audit log as they are checked, exported and signed.

A trigger writes them (sql/0028_audit_chain.sql). Only relays write signed heads.
"""

from collections.abc import Callable, Iterator

from robotether_server.audit_chain import (
    ChainEnd,
    ChainLine,
    Record,
    SignedHead,
    Signer,
    start_hash,
)
from robotether_server.db.database import Transaction

PIECE = 5000
LINE = (
    "position, CAST(UNIX_TIMESTAMP(at) AS CHAR) AS at, actor, kind, robot, address, details, "
    "LOWER(HEX(hash)) AS hash"
)
HEAD = (
    "chain, position, LOWER(HEX(hash)) AS hash, signer, public_key, "
    "LOWER(HEX(previous)) AS previous, signature, lost_since"
)


def read_chains(tx: Transaction, chain: str | None = None) -> Iterator[Record]:
    """Read all chains, or one, as of one point in time; must be the first read of its transaction."""
    tx.change("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ")
    for end in _ends(tx, chain):
        yield end
        yield from read_heads(tx, end.chain)
        yield from _lines(tx, end.chain)


def lines_outside(tx: Transaction, limit: int) -> list[int]:
    """Return the ids of lines that should be in a chain: they are newer than the first that is in one."""
    rows = tx.rows(
        "SELECT id FROM audit_events WHERE position IS NULL AND kind <> 'key_refused' "
        "AND id > (SELECT MIN(id) FROM audit_events WHERE position IS NOT NULL) ORDER BY id LIMIT %s",
        (limit,),
    )
    return [row["id"] for row in rows]


def read_heads(tx: Transaction, chain: str) -> list[SignedHead]:
    """Return the signed heads of a chain, the oldest first."""
    rows = tx.rows(
        f"SELECT {HEAD} FROM audit_heads WHERE chain = %s ORDER BY position, signer",  # noqa: S608 - the module's own text
        (chain,),
    )
    return [SignedHead(**row) for row in rows]


def read_lines(tx: Transaction, chain: str, after: int, limit: int) -> list[ChainLine]:
    """Return lines of a chain that follow a position, in order."""
    rows = tx.rows(
        f"SELECT {LINE} FROM audit_events WHERE robot <=> %s AND position > %s "  # noqa: S608 - as above
        "ORDER BY position LIMIT %s",
        (chain or None, after, limit),
    )
    return [ChainLine(**row) for row in rows]


def next_head(tx: Transaction, chain: str, signer: Signer, position: int) -> SignedHead | None:
    """Return the first head of this signer from a position on, of a line that is in the log."""
    row = tx.row(
        f"SELECT {HEAD} FROM audit_heads WHERE chain = %s AND signer = %s AND position >= %s AND lost_since IS NULL "  # noqa: S608 - as above
        "ORDER BY position LIMIT 1",
        (chain, signer, position),
    )
    return None if row is None else SignedHead(**row)


def hash_before(tx: Transaction, chain: str, position: int) -> str:
    """Return the hash that the line at a position follows: of the line before, which may be deleted, or the start's."""
    lines = read_lines(tx, chain, position - 2, 1) if position > 1 else []
    if lines and lines[0].position == position - 1:
        return lines[0].hash
    head = next_head(tx, chain, "server", position - 1) if position > 1 else None
    return start_hash(chain) if head is None else head.hash


def sign_newest(
    tx: Transaction, chain: str, sign: Callable[[ChainEnd], SignedHead]
) -> tuple[ChainEnd, str | None] | None:
    """Sign the newest line of a chain for the server; return it, and the SHA-256 of the robot's newest statement.

    None: there is no such chain, or the robot has signed that line, too.
    """
    row = tx.row(
        "SELECT chain, position, LOWER(HEX(hash)) AS hash FROM audit_chains WHERE chain = %s",
        (chain,),
    )
    if row is None:
        return None
    end = ChainEnd(**row)
    heads = tx.rows(
        f"SELECT {HEAD} FROM audit_heads WHERE chain = %s AND signer = 'robot' "  # noqa: S608 - as above
        "ORDER BY position DESC, id DESC LIMIT 1",
        (chain,),
    )
    newest = SignedHead(**heads[0]) if heads else None
    head = sign(end)
    tx.change(
        "INSERT IGNORE INTO audit_heads (chain, position, hash, signer, public_key, signature) "
        "VALUES (%s, %s, UNHEX(%s), 'server', %s, %s)",
        (chain, end.position, end.hash, head.public_key, head.signature),
    )
    if newest is None:
        return end, None
    return None if newest.position >= end.position else (end, newest.statement_hash)


def add_robots_head(tx: Transaction, head: SignedHead) -> bool:
    """Add what a robot signed; return whether it is there.

    That line must be in the log, or have been lost when a backup was put back.
    """
    row = tx.row(
        "CALL add_robots_head(%s, %s, UNHEX(%s), %s, UNHEX(%s), %s)",
        (head.chain, head.position, head.hash, head.public_key, head.previous, head.signature),
    )
    return row is not None and bool(row["is_kept"])


def chains_to_sign(tx: Transaction) -> list[str]:
    """Return chains that have new lines, and were last signed a day ago."""
    rows = tx.rows(
        "SELECT c.chain FROM audit_chains c LEFT JOIN ("
        "SELECT chain, MAX(position) AS position, MAX(signed_at) AS signed_at FROM audit_heads "
        "WHERE signer = 'server' GROUP BY chain) h ON h.chain = c.chain "
        "WHERE c.position > IFNULL(h.position, 0) "
        "AND IFNULL(h.signed_at < CURRENT_TIMESTAMP(6) - INTERVAL 1 DAY, TRUE) LIMIT 1000"
    )
    return [row["chain"] for row in rows]


def _lines(tx: Transaction, chain: str) -> Iterator[ChainLine]:
    after = 0
    while piece := read_lines(tx, chain, after, PIECE):
        yield from piece
        if piece[-1].position <= after:
            return
        after = piece[-1].position


def _ends(tx: Transaction, chain: str | None) -> list[ChainEnd]:
    """Return all chains; one that the database does not count any more has no newest line."""
    rows = tx.rows(
        "SELECT chain, position, LOWER(HEX(hash)) AS hash FROM audit_chains "
        "UNION ALL SELECT DISTINCT IFNULL(robot, ''), CAST(0 AS UNSIGNED), '' FROM audit_events e "
        "WHERE position IS NOT NULL "
        "AND NOT EXISTS (SELECT 1 FROM audit_chains c WHERE c.chain = IFNULL(e.robot, '')) "
        "UNION ALL SELECT DISTINCT chain, CAST(0 AS UNSIGNED), '' FROM audit_heads h "
        "WHERE NOT EXISTS (SELECT 1 FROM audit_chains c WHERE c.chain = h.chain)"
    )
    ends = {row["chain"]: ChainEnd(**row) for row in rows}
    return [ends[name] for name in sorted(ends) if chain in (None, name)]
