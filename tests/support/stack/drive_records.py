"""Drives in the database as the relay leaves them, for tests of those who show them."""

from __future__ import annotations

from robotether_server.db import Database


def add_drive(admin_database: Database, robot: str, user: str, **changes: object) -> int:
    """Add a drive of ten minutes; `changes` are columns. The robot may be one that is gone.

    Its driver's account, if there is one, is older than that.
    """
    columns: dict[str, object] = {
        "fence": 13,
        "started_at": "2026-01-31 12:00:00",
        "ended_at": "2026-01-31 12:10:00",
        "end_code": "lease_lost",
        "distance_m": 12.34,
        "top_speed_m_s": 0.75,
        "messages": 4000,
        "dropped_old": 2,
        "refused": '{"topic": 3}',
        "address": "198.51.100.7",
        "latency_p50_ms": 41.2,
        "latency_p95_ms": 80.5,
        "seen_p50_ms": 140.2,
        "seen_p95_ms": 210.5,
        "seen_p99_ms": 380.0,
        "seen_max_ms": 512.3,
        "seen_unknown": 4,
        "slowed_s": 12.0,
        "bytes": 1_234_567,
        "pictures": 6000,
        "picture_bytes": 180_000_000,
        "viewed_s": 400.0,
    } | changes
    names, marks = ", ".join(columns), ", ".join(["%s"] * len(columns))
    with admin_database.transaction() as tx:
        tx.change(
            "UPDATE users SET created_at = LEAST(created_at, %s) WHERE name = %s",
            (columns["started_at"], user),
        )
        return tx.insert(
            f"INSERT INTO drives (robot, user_name, robot_id, {names}) "
            f"VALUES (%s, %s, (SELECT id FROM robots WHERE name = %s), {marks})",
            (robot, user, robot, *columns.values()),
        )
