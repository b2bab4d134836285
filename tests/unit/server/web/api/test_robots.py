"""The robots that a user may see."""

from __future__ import annotations

from robotether_server.store import Database
from web_visitor import Browser, bearer


def test_robots_are_listed_with_what_the_user_may(program: Browser, database: Database) -> None:
    """A user sees granted robots; an admin sees all, to manage."""
    answer = program.ask("GET", "/api/v1/robots", headers=bearer(database, "ann"))
    assert answer.json == {
        "robots": [
            {
                "name": "sim1",
                "mac": "02:00:00:00:51:01",
                "state": "pending",
                "online": False,
                "since": None,
                "level": "drive",
                "ros_port": 20000,
                "video_port": 20001,
            }
        ]
    }
    seen = program.ask("GET", "/api/v1/robots", headers=bearer(database, "root")).json["robots"]
    assert [(robot["name"], robot["level"]) for robot in seen] == [
        ("sim1", "manage"),
        ("sim2", "manage"),
    ]


def test_online_robot_has_since(
    program: Browser, database: Database, admin_database: Database
) -> None:
    """The moment is RFC 3339 in UTC, to the second."""
    with admin_database.transaction() as tx:
        tx.insert(
            "INSERT INTO robot_sessions (robot_id, address, started_at) "
            "SELECT id, '', '2026-01-01 12:03:00.9' FROM robots WHERE name = 'sim1'"
        )
    [robot] = program.ask("GET", "/api/v1/robots", headers=bearer(database, "ann")).json["robots"]
    assert (robot["online"], robot["since"]) == (True, "2026-01-01T12:03:00Z")
