"""A user's own right on one robot, given and taken as tests of the records need it."""

from __future__ import annotations

from robotether_server.db import Transaction, grants
from robotether_server.db.grants import Pair
from robotether_server.schemas import Level


def give(tx: Transaction, user_id: int, robot_id: int, level: Level) -> None:
    grants.put(tx, Pair(user_id=user_id, robot_id=robot_id), level)


def take(tx: Transaction, user_id: int, robot_id: int) -> None:
    found = grants.find(tx, Pair(user_id=user_id, robot_id=robot_id))
    assert found is not None
    grants.remove(tx, found.id)
