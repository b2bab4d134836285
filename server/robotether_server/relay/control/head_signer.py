"""Signs the audit log's chains at each drive's end and once a day, and has robots sign theirs (docs/adr/0054).

`event_writer` says what is written, `robot_link` what a robot signed; a task of its own does all the work, so that no
message, stop or lease waits for it. What cannot be signed now is signed at the next drive's end, or a day later.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Callable, Sequence

from robotether_common.audit_head import MAX_STATEMENTS, NAMESPACE, statement

from robotether_server import signatures
from robotether_server.audit_chain import ChainEnd, SignedHead
from robotether_server.db.fleet import AuditEntry, Entry, RelayRobot, Snapshot
from robotether_server.problems import StoreError
from robotether_server.relay.records.database import RelayDatabase
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.session_messages import SignedHeadLine, sign_head_line
from robotether_server.signatures import SigningKey
from robotether_server.tasks import wait_for_event

log = logging.getLogger(__name__)

SWEEP_EVERY_S = 3600.0
# Maximum number of robots' answers that wait.
MAX_ANSWERS = 1000
# Maximum length of a signature in the database; RSA's with 4096 bits have some 1500 characters.
MAX_KEPT = 2048


class HeadSigner:
    """The server's key, what is to be signed, and what robots have signed."""

    def __init__(
        self,
        database: RelayDatabase,
        registry: SessionRegistry,
        snapshot: Callable[[], Snapshot],
        key: SigningKey,
    ) -> None:
        self._database = database
        self._registry = registry
        self._snapshot = snapshot
        self._key = key
        self._due: set[str] = set()
        self._answers: deque[tuple[int, SignedHeadLine]] = deque()
        self._wake = asyncio.Event()
        self._sweep_at = 0.0

    def on_written(self, entries: Sequence[Entry]) -> None:
        """Sign the chains of robots whose drives have ended."""
        for entry in entries:
            if isinstance(entry, AuditEntry) and entry.kind == "drive_ended" and entry.robot:
                self._due.add(entry.robot)
                self._wake.set()

    def on_signed_head(self, robot_id: int, line: SignedHeadLine) -> None:
        """Keep a robot's signature; what it was not asked for, or finds no room, is dropped."""
        robot = self._registry.robot(robot_id)
        if len(self._answers) >= MAX_ANSWERS:
            self._drop_next(robot_id)
        elif robot.expected_heads > 0:
            robot.expected_heads -= 1
            self._answers.append((robot_id, line))
            self._wake.set()

    async def run(self) -> None:
        """Sign for ever."""
        while True:
            await wait_for_event(self._wake, max(self._sweep_at - time.monotonic(), 1.0))
            try:
                await self._work()
            except StoreError as problem:
                log.info("cannot sign the audit log now: %s", problem.detail)
            except Exception:
                # As while the database has still the tables of an earlier version. What failed is given up
                # until it is due again; the rest is not.
                log.exception("cannot sign the audit log now")
                self._wake.set()

    async def _work(self) -> None:
        await self._keep_answers()
        if time.monotonic() >= self._sweep_at:
            self._sweep_at = time.monotonic() + SWEEP_EVERY_S
            self._due.update(await self._database.chains_to_sign())
        while self._due:
            chain = self._due.pop()
            try:
                await self._sign(chain)
            except StoreError:
                self._due.add(chain)
                raise
            await self._keep_answers()

    async def _keep_answers(self) -> None:
        while self._answers:
            robot_id, line = self._answers.popleft()
            try:
                await self._keep(robot_id, line)
            except StoreError:
                self._answers.appendleft((robot_id, line))
                raise
            except Exception:
                self._answers = deque(each for each in self._answers if each[0] != robot_id)
                self._drop_next(robot_id)
                raise

    def _drop_next(self, robot_id: int) -> None:
        """Drop a robot's answers until it is asked again: then it sends all that are missing.

        If those behind a missing one were kept, it would look as if it had been taken out of the log.
        """
        self._registry.robot(robot_id).expected_heads = 0

    async def _sign(self, chain: str) -> None:
        request = await self._database.sign_newest(chain, self._signed)
        robot = self._snapshot().by_name.get(chain)
        link = None if robot is None else self._registry.session_of(robot.id)
        if request is None or robot is None or link is None:
            return
        end, newest = request
        self._registry.ensure_robot(robot.id).expected_heads = MAX_STATEMENTS
        link.send(sign_head_line(chain, end.position, end.hash, newest))

    def _signed(self, end: ChainEnd) -> SignedHead:
        text = statement(end.chain, end.position, end.hash, None)
        signature = self._key.sign(NAMESPACE, text)
        return SignedHead(
            end.chain, end.position, end.hash, "server", self._key.public_key, None, signature
        )

    async def _keep(self, robot_id: int, line: SignedHeadLine) -> None:
        robot = self._snapshot().robots.get(robot_id)
        head = None if robot is None else _robots_head(robot, line)
        if head is None or not await self._database.add_robots_head(head):
            name = robot_id if robot is None else robot.name
            log.warning(
                "robot %s: what it signed of the audit log does not fit: %r", name, line.position
            )


def _robots_head(robot: RelayRobot, line: SignedHeadLine) -> SignedHead | None:
    """Return what a robot signed, None: not with its key."""
    key = signatures.key_of(line.signature)
    keys = (robot.fingerprint, robot.previous_fingerprint)
    if key is None or signatures.fingerprint(key) not in keys or len(line.signature) > MAX_KEPT:
        return None
    head = SignedHead(
        robot.name, line.position, line.hash, "robot", key, line.previous, line.signature
    )
    return head if head.is_signed else None
