"""What an admin does with a robot by a yes."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from admin_visitor import fingerprint, join, send
from robotether_server.db import Database, robots
from robotether_server.db.robots import Robot
from web_visitor import Browser, audit_kinds

MAC = "02:00:00:00:51:01"


@pytest.fixture
def active(admin: Browser, program: Browser) -> None:
    """sim1 has joined and is approved."""
    join(program, MAC, 1)
    form = {"robot": "sim1", "fingerprint": fingerprint(1), "name": "sim1"}
    assert send(admin, "/admin/pending", **form).status_code == 303


def sim1(database: Database) -> Robot:
    """Its row."""
    with database.transaction() as tx:
        return robots.get(tx, "sim1")


@pytest.mark.usefixtures("active")
@pytest.mark.parametrize(
    ("actions", "is_done", "kind"),
    [
        (["disable"], lambda robot: robot.state == "disabled", "robot_disabled"),
        (["disable", "enable"], lambda robot: robot.state == "active", "robot_enabled"),
        (["rekey"], lambda robot: robot.fingerprint is None, "robot_rekeyed"),
        (["rotate-key"], lambda robot: robot.rotate_requested_at, "robot_rotation_requested"),
        (["shell-on"], lambda robot: robot.shell_port is not None, "robot_shell_set"),
        (["shell-on", "shell-off"], lambda robot: robot.shell_port is None, "robot_shell_set"),
    ],
)
def test_deed_is_done_and_audited(
    admin: Browser,
    database: Database,
    actions: list[str],
    is_done: Callable[[Robot], bool],
    kind: str,
) -> None:
    """Each leads back to the robot's page."""
    for action in actions:
        answer = send(admin, f"/admin/robots/sim1/{action}")
        assert (answer.status_code, answer.location) == (303, "/admin/robots/sim1")
    assert is_done(sim1(database))
    assert audit_kinds(database)[-1] == (kind, "root", "198.51.100.7")


@pytest.mark.usefixtures("active")
def test_a_removed_robot_is_gone(admin: Browser, database: Database) -> None:
    """The page says before that nobody can bring it back."""
    assert "cannot be brought back" in admin.ask("GET", "/admin/robots/sim1/remove").text
    answer = send(admin, "/admin/robots/sim1/remove")
    assert (answer.status_code, answer.location) == (303, "/admin/robots")
    assert admin.ask("GET", "/admin/robots/sim1").status_code == 404
    assert audit_kinds(database)[-1][0] == "robot_removed"


@pytest.mark.parametrize("action", ["enable", "rotate-key"])
def test_what_the_state_does_not_allow_is_said(admin: Browser, action: str) -> None:
    """On the page that asked."""
    answer = send(admin, f"/admin/robots/sim1/{action}")
    assert (answer.status_code, "it is pending" in answer.text) == (409, True)


ACTIONS = ("disable", "enable", "rekey", "rotate-key", "shell-on", "shell-off", "remove")


@pytest.mark.parametrize("action", ACTIONS)
def test_no_deed_on_a_robot_that_is_not_there(admin: Browser, action: str) -> None:
    """Neither asked about nor done."""
    assert admin.ask("GET", f"/admin/robots/ghost/{action}").status_code == 404
    assert send(admin, f"/admin/robots/ghost/{action}").status_code == 404
