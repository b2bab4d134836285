"""The audit log's chains: what of a line is hashed, what a head is signed over, and the first line that does not fit.

Pure. The contract is docs/reference/audit-log.md; lines are written by a trigger (sql/0028_audit_chain.sql), which
hashes the same. Hashes are SHA-256 in hex.
"""

import datetime as dt
import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from msgspec import Struct
from robotether_common.audit_head import NAMESPACE, statement

from robotether_server import signatures
from robotether_server.signatures import SigningKey

# Kind of the line that a restored backup adds to each chain.
RESTORED = "records_restored"
# Kind of the line that a relay adds instead of lines that it could not write.
LINES_LOST = "lines_lost"
# Purpose of the server's key, which relays derive from the session key.
SERVER_KEY_PURPOSE = "robotether audit heads"

Signer = Literal["server", "robot"]


class ChainEnd(Struct, frozen=True, tag="chain"):
    """A chain with its newest line, as the database counts it; `chain` is the robot's name, empty for lines without."""

    chain: str
    position: int
    hash: str


class ChainLine(Struct, frozen=True, tag="line"):
    """A line; `at` is its Unix time with six decimals, `details` JSON as it was written."""

    position: int
    at: str
    actor: str
    kind: str
    robot: str | None
    address: str | None
    details: str
    hash: str


class SignedHead(Struct, frozen=True, tag="head"):
    """A line's hash, signed; `previous` is the SHA-256 of the statement that the robot signed before.

    `lost_since`: position of the line which says that a backup was put back, and the line that the robot signed is no
    longer in the log; None: it is.
    """

    chain: str
    position: int
    hash: str
    signer: Signer
    public_key: str
    previous: str | None
    signature: str
    lost_since: int | None = None

    @property
    def statement(self) -> str:
        """What is signed."""
        return statement(self.chain, self.position, self.hash, self.previous)

    @property
    def statement_hash(self) -> str:
        """What the robot's next statement names."""
        return hashlib.sha256(self.statement.encode()).hexdigest()

    @property
    def is_signed(self) -> bool:
        """Whether the signature is that key's."""
        return signatures.is_signed(self.public_key, NAMESPACE, self.statement, self.signature)


Record = ChainEnd | SignedHead | ChainLine


@dataclass
class Restore:
    """A backup that was put back: its line's position and time, and what the robot had signed that is lost since.

    `lost_up_to`: the last line that this restore took away; None: of none is that known. `perhaps_up_to`: the last that
    this one or another took away, nobody knows which; None: there is none.
    """

    line: int
    at: str
    lost_up_to: int | None = None
    perhaps_up_to: int | None = None


@dataclass
class ChainReport:
    """What was found in one chain; `fault` names its first line that does not fit."""

    chain: str
    fault: str | None = None
    lines: int = 0
    # Lines that retention deleted, up to a signed head.
    deleted: int = 0
    # Positions of the newest heads, and the fingerprints of all keys that signed.
    signed: dict[Signer, int] = field(default_factory=dict)
    keys: dict[Signer, list[str]] = field(default_factory=dict)
    # Lines at which the robot signed without what it had signed before.
    restarts: list[int] = field(default_factory=list)
    # Lines at which a backup was put back.
    restores: list[Restore] = field(default_factory=list)

    @property
    def name(self) -> str:
        """What people call the chain."""
        return self.chain or "lines without a robot"


def server_key(secret: str) -> SigningKey:
    """Return the server's key for heads, which all its relays derive from one secret."""
    return SigningKey(secret, SERVER_KEY_PURPOSE)


def start_hash(chain: str) -> str:
    """Return what stands for the line before the first."""
    return hashlib.sha256(f"robotether audit chain 1:{chain}".encode()).hexdigest()


def content_hash(line: ChainLine) -> bytes:
    """Return the hash of a line by itself: its fields, each after its length in bytes; `-` where there is none."""
    fields = (str(line.position), line.at, line.actor, line.kind)
    fields += (line.robot, line.address, line.details)  # type: ignore[assignment] # some may be None
    encoded = [None if value is None else value.encode() for value in fields]
    parts = [b"-" if value is None else b"%d:%b" % (len(value), value) for value in encoded]
    return hashlib.sha256(b"".join(parts)).digest()


def next_hash(before: str, content: bytes) -> str:
    """Return a line's hash from that of the line before it and its own content's."""
    return hashlib.sha256(bytes.fromhex(before) + content).hexdigest()


def check(
    records: Iterable[Record],
    *,
    server_keys: Collection[str] = (),
    older_heads: Mapping[str, Sequence[SignedHead]] | None = None,
) -> list[ChainReport]:
    """Check chains: of each its end, then its heads, then its lines in order.

    `server_keys`: fingerprints of the keys that may sign for the server, empty: any. `older_heads`: those of an earlier
    export, by chain, which must fit as well.
    """
    checks: dict[str, _ChainCheck] = {}
    current: _ChainCheck | None = None
    for record in records:
        if isinstance(record, ChainEnd):
            is_repeated = record.chain in checks
            current = checks.setdefault(record.chain, _ChainCheck(record, server_keys))
            if is_repeated:
                current.fail("it is there twice")
            else:
                current.heads += (older_heads or {}).get(record.chain, ())
        elif current is None:
            checks[""] = current = _ChainCheck(ChainEnd("", 0, start_hash("")), server_keys)
            current.fail("the file does not begin with a chain")
        elif isinstance(record, SignedHead):
            current.add_head(record)
        else:
            current.add(record)
    for chain, heads in (older_heads or {}).items():
        if heads and chain not in checks:
            checks[chain] = _ChainCheck(ChainEnd(chain, 0, start_hash(chain)), server_keys)
            checks[chain].fail("its chain is missing, and was signed")
    return [check.finish() for check in checks.values()]


class _ChainCheck:
    """Checks one chain, a line at a time; of several faults the first counts."""

    def __init__(self, end: ChainEnd, server_keys: Collection[str]) -> None:
        self._end = end
        self._server_keys = server_keys
        self.heads: list[SignedHead] = []
        self._by_position: dict[int, list[SignedHead]] | None = None
        self._report = ChainReport(end.chain)
        self._position, self._hash = 0, start_hash(end.chain)

    def fail(self, why: str) -> None:
        """Note what does not fit."""
        if self._report.fault is None:
            self._report.fault = why

    def add_head(self, head: SignedHead) -> None:
        """Take a head, which the lines must fit."""
        if self._by_position is not None:
            self.fail(f"the signature of line {head.position} stands behind a line")
        self.heads.append(head)

    def add(self, line: ChainLine) -> None:
        """Check the next line."""
        if self._report.fault is not None:
            return
        if self._by_position is None:
            self._begin(line.position)
        self._position += 1
        expected = next_hash(self._hash, content_hash(line))
        if line.position != self._position:
            self.fail(f"line {self._position} is missing; line {line.position} follows")
        elif (line.robot or "") != self._end.chain:
            self.fail(f"line {line.position} is of another chain")
        elif line.hash != expected:
            self.fail(
                f"line {line.position} of {_time(line)} ({line.kind}) was changed, or one before"
            )
        if line.kind == RESTORED:
            self._report.restores.append(Restore(line.position, _time(line)))
        self._hash = line.hash
        self._check_heads(self._position)
        self._report.lines += 1

    def finish(self) -> ChainReport:
        """Check what follows from all lines, and return what was found."""
        if self._report.fault is None and self._by_position is None:
            self._begin(self._end.position + 1)
        if self._report.fault is None:
            self._check_end()
            self._check_statements()
        return self._report

    def _begin(self, first: int) -> None:
        """Check the signatures, and begin behind the head up to which lines were deleted."""
        self._by_position = {}
        for head in self.heads:
            if head.lost_since is None:
                self._by_position.setdefault(head.position, []).append(head)
            self._check_signature(head)
        if first > 1:
            anchors = [h for h in self._by_position.get(first - 1, ()) if h.signer == "server"]
            if not anchors:
                self.fail(f"line {first - 1} is missing, and no signed head of the server says so")
                return
            self._position, self._hash = first - 1, anchors[0].hash
            self._report.deleted = first - 1
            self._check_heads(first - 1)

    def _check_signature(self, head: SignedHead) -> None:
        if not head.is_signed or head.chain != self._end.chain:
            self.fail(f"the {head.signer}'s signature of line {head.position} does not fit")
            return
        key = signatures.fingerprint(head.public_key)
        if head.signer == "server" and self._server_keys and key not in self._server_keys:
            self.fail(f"line {head.position} is signed by {key}, which is not the server's key")
        keys = self._report.keys.setdefault(head.signer, [])
        if key not in keys:
            keys.append(key)
        if head.lost_since is None:
            newest = max(head.position, self._report.signed.get(head.signer, 0))
            self._report.signed[head.signer] = newest
        elif head.signer == "server":
            self.fail(f"line {head.position} cannot be lost: the server signed it")

    def _check_heads(self, position: int) -> None:
        for head in (self._by_position or {}).get(position, ()):
            if head.hash != self._hash:
                self.fail(f"line {position} is not the one that the {head.signer} signed")

    def _check_end(self) -> None:
        signed = max(self._report.signed.values(), default=0)
        if max(signed, self._end.position) > self._position:
            last = max(signed, self._end.position)
            self.fail(f"line {self._position + 1} is missing; the newest was line {last}")
        elif (self._position, self._hash) != (self._end.position, self._end.hash):
            self.fail(f"line {self._position} is not the newest that the database counted")

    def _check_statements(self) -> None:
        """Check that each statement of the robot names one before, so that none in between is missing.

        What it signed of lost lines comes after the lines before the restore, and before those after it. So a restore
        explains no loss of lines that the robot signed later. An earlier export has statements about lines that were
        deleted since.
        """
        heads = {h.statement_hash: h for h in self.heads if h.signer == "robot"}
        first = (self._report.deleted, True, 0)
        seen: set[str] = set()
        for head in sorted(heads.values(), key=_sort_key):
            if _sort_key(head) < first:
                continue
            if head.previous is None:
                if seen:
                    self._report.restarts.append(head.position)
            elif head.previous not in seen and (seen or not self._report.deleted):
                self.fail(f"what the robot signed before line {head.position} is missing")
            seen.add(head.statement_hash)
            if head.lost_since is not None:
                self._note_loss(head.position, head.lost_since)

    def _note_loss(self, position: int, since: int) -> None:
        """Note a line as lost by the restore that explains it, or by each that may.

        `since` is the first after what the robot had signed before; one behind the line took none away.
        """
        restores = [item for item in self._report.restores if since <= item.line <= position]
        if not restores or restores[0].line != since:
            self.fail(
                f"line {position}, which the robot signed, is lost, and no restored backup says so"
            )
        for restore in restores:
            if len(restores) == 1:
                restore.lost_up_to = max(position, restore.lost_up_to or 0)
            else:
                restore.perhaps_up_to = max(position, restore.perhaps_up_to or 0)


def _sort_key(head: SignedHead) -> tuple[int, bool, int]:
    if head.lost_since is None:
        return head.position, True, head.position
    return head.lost_since, False, head.position


def _time(line: ChainLine) -> str:
    try:
        at = dt.datetime.fromtimestamp(float(line.at), dt.UTC)
    except (OverflowError, ValueError, OSError):
        # In a file anything may stand here.
        return f"Unix time {line.at!r}"
    return f"{at:%Y-%m-%d %H:%M:%S} UTC"
