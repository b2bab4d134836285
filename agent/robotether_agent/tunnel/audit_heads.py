"""Signs the newest line of the robot's chain in the server's audit log, with the robot's key, when the server asks.

Each statement names the one before, and the agent sends those again that the server lacks: nobody can remove a line
that the robot has signed unseen (docs/reference/audit-log.md). Never signs an earlier line than before.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import logging
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, cast

from robotether_common.audit_head import MAX_STATEMENTS, NAMESPACE, statement

from robotether_agent.enrolment.enroller import AUDIT_HEADS_FILE
from robotether_agent.enrolment.keys import KeyPair, sign
from robotether_agent.fields import FieldError, parse_object
from robotether_agent.files import read_text, write_atomic
from robotether_agent.problems import AgentError
from robotether_agent.tunnel.session import HeadRequest, Session

# What the robot signed: chain, position, hash, previous and signature.
Statement = dict[str, Any]

log = logging.getLogger(__name__)


async def sign_heads(
    state_dir: Path, key: Callable[[], Awaitable[KeyPair]], session: Session
) -> None:
    """Answer the server's requests, the newest first, for as long as the session lasts."""
    while True:
        request = await session.next_head_request()
        try:
            for item in await _statements(state_dir, key, request):
                session.send({"type": "signed_head", **item})
        except AgentError as problem:
            log.warning("cannot sign the server's audit log: %s", problem)


async def _statements(
    state_dir: Path, key: Callable[[], Awaitable[KeyPair]], request: HeadRequest
) -> list[Statement]:
    """Return what the server lacks, the oldest first, with a statement about the line that it names."""
    chain, position, line_hash = request.chain, request.position, request.hash
    stored = _read(state_dir / AUDIT_HEADS_FILE)
    made = [item for item in stored if item["chain"] == chain]
    # Of names that the robot had before: it may get one of them back.
    others = [item for item in stored if item["chain"] != chain]
    if made and position < made[-1]["position"]:
        newest = made[-1]["position"]
        log.warning("not signing the audit log: it went back from line %d to %d", newest, position)
        return made
    if not made or (position, line_hash) != (made[-1]["position"], made[-1]["hash"]):
        previous = _sha256(made[-1]) if made else None
        text = statement(chain, position, line_hash, previous)
        signature = await sign(await key(), NAMESPACE, text)
        new = {"chain": chain, "position": position, "hash": line_hash}
        made.append({**new, "previous": previous, "signature": signature})
        # Before it is sent: one that is forgotten would look as if it had been taken out of the log.
        statements = [*others[-MAX_STATEMENTS:], *made[-MAX_STATEMENTS:]]
        text = json.dumps({"statements": statements})
        # The next driver may have begun, and the guard stops a robot whose agent waits for a slow disk.
        await asyncio.to_thread(write_atomic, state_dir / AUDIT_HEADS_FILE, text, 0o600)
    hashes = [_sha256(item) for item in made]
    return made[hashes.index(request.newest) + 1 :] if request.newest in hashes else made


def _sha256(item: Statement) -> str:
    text = statement(item["chain"], item["position"], item["hash"], item["previous"])
    return hashlib.sha256(text.encode()).hexdigest()


def _read(path: Path) -> list[Statement]:
    """Return what the robot signed last; a file that cannot be read is as none, which the log then shows."""
    text = read_text(path)
    if text is None:
        return []
    try:
        statements = cast("list[Statement]", parse_object(text, str(path))["statements"])
        for item in statements:
            _sha256(item)
    except (FieldError, KeyError, TypeError) as error:
        log.warning("cannot read %s: %r; starting to sign again", path, error)
        return []
    return statements
