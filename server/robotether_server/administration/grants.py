"""Grants: which user may observe, drive or manage which robot."""

from robotether_server.problems import RecordMissing
from robotether_server.store import Transaction, audit, grants, robots, users
from robotether_server.store.audit import Event, Source
from robotether_server.store.grants import Grant, Level


def grant(tx: Transaction, source: Source, user: str, robot: str, level: Level) -> None:
    """Let a user do this with a robot, in place of an earlier grant; raise RecordMissing."""
    robot_id = robots.get(tx, robot).id
    grants.give(tx, users.get(tx, user).id, robot_id, level)
    audit.record(tx, source, Event("grant_given", robot, {"user": user, "level": level}))


def revoke(tx: Transaction, source: Source, user: str, robot: str) -> None:
    """Take a user's grant for a robot away; raise RecordMissing when there is none."""
    robot_id = robots.get(tx, robot).id
    if not grants.take(tx, users.get(tx, user).id, robot_id):
        raise RecordMissing(f"cannot revoke: user {user} has no grant for robot {robot}")
    audit.record(tx, source, Event("grant_taken", robot, {"user": user}))


def list_all(tx: Transaction) -> list[Grant]:
    """Return every grant, by user and robot; admins need none."""
    return grants.list_all(tx)
