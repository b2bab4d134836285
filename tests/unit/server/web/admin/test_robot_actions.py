"""What an admin does with a robot by a yes."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from admin_visitor import fingerprint, join, send
from robotether_server.db import Database, robots
from robotether_server.db.robots import Robot
from web_visitor import Browser, audit_kinds

MAC = "02:00:00:00:51:01"


ACTIONS = ("disable", "enable", "rekey", "rotate-key", "shell-on", "shell-off", "remove")


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
    assert "cannot be restored" in admin.ask("GET", "/admin/robots/sim1/remove").text
    answer = send(admin, "/admin/robots/sim1/remove")
    assert (answer.status_code, answer.location) == (303, "/admin/robots")
    assert admin.ask("GET", "/admin/robots/sim1").status_code == 404
    assert audit_kinds(database)[-1][0] == "robot_removed"


@pytest.mark.parametrize("action", ["enable", "rotate-key"])
def test_what_the_state_does_not_allow_is_said(admin: Browser, action: str) -> None:
    """On the page that asked."""
    answer = send(admin, f"/admin/robots/sim1/{action}")
    assert (answer.status_code, "it is pending" in answer.text) == (409, True)


@pytest.mark.parametrize("action", ACTIONS)
def test_no_deed_on_a_robot_that_is_not_there(admin: Browser, action: str) -> None:
    """Neither asked about nor done."""
    assert admin.ask("GET", f"/admin/robots/ghost/{action}").status_code == 404
    assert send(admin, f"/admin/robots/ghost/{action}").status_code == 404


def get(database: Database, name: str) -> Robot:
    """The robot's row."""
    with database.transaction() as tx:
        return robots.get(tx, name)


def test_a_renamed_robot_has_another_page(admin: Browser, database: Database) -> None:
    """And everything else stays."""
    before = get(database, "sim1")
    answer = send(admin, "/admin/robots/sim1/rename", new_name="lift")
    assert (answer.status_code, answer.location) == (303, "/admin/robots/lift")
    assert get(database, "lift").ros_port == before.ros_port


def test_a_robot_gets_another_mac(admin: Browser, database: Database) -> None:
    """In any spelling."""
    assert send(admin, "/admin/robots/sim1/mac", mac="001b44113ab7").status_code == 303
    assert get(database, "sim1").mac == "00:1b:44:11:3a:b7"


def test_form_shows_what_is_now(admin: Browser) -> None:
    """The present MAC stands in the field, the present ports in the text."""
    assert 'value="02:00:00:00:51:01"' in admin.ask("GET", "/admin/robots/sim1/mac").text
    assert "Now: 20000" in admin.ask("GET", "/admin/robots/sim1/ports").text


def test_ports_move_to_those_named(admin: Browser, database: Database) -> None:
    """Both or neither."""
    form = {"ros_port": "20100", "video_port": "20101"}
    assert send(admin, "/admin/robots/sim1/ports", **form).status_code == 303
    assert (get(database, "sim1").ros_port, get(database, "sim1").video_port) == (20100, 20101)
    answer = send(admin, "/admin/robots/sim1/ports", ros_port="20100")
    assert (answer.status_code, 'value="20100"' in answer.text) == (422, True)


def test_ports_move_to_a_free_pair(admin: Browser, database: Database) -> None:
    """When the form is empty."""
    before = get(database, "sim1").ros_port
    assert send(admin, "/admin/robots/sim1/ports").status_code == 303
    assert get(database, "sim1").ros_port != before


def test_ports_of_another_robot_are_refused(admin: Browser, database: Database) -> None:
    """With a sentence, and the form as it was."""
    taken = get(database, "sim2").ros_port
    form = {"ros_port": str(taken), "video_port": str(taken + 1)}
    answer = send(admin, "/admin/robots/sim1/ports", **form)
    assert (answer.status_code, f"{taken}" in answer.text, "form-problem" in answer.text) == (
        409,
        True,
        True,
    )


def test_shell_user_is_set_and_cleared(admin: Browser, database: Database) -> None:
    """Empty: everybody's own name."""
    send(admin, "/admin/robots/sim1/shell-user", shell_user="pi")
    assert get(database, "sim1").settings == {"shell_user": "pi"}
    send(admin, "/admin/robots/sim1/shell-user", shell_user="")
    assert get(database, "sim1").settings == {}


@pytest.mark.parametrize(
    ("path", "form"),
    [
        ("rename", {"new_name": ""}),
        ("rename", {"new_name": "a b"}),
        ("mac", {"mac": "ff:ff:ff:ff:ff:ff"}),
        ("ports", {"ros_port": "x", "video_port": "20101"}),
        ("shell-user", {"shell_user": "a b"}),
    ],
)
def test_what_is_wrong_comes_back(admin: Browser, path: str, form: dict[str, str]) -> None:
    """With the form and the sentence."""
    answer = send(admin, f"/admin/robots/sim1/{path}", **form)
    assert (answer.status_code, "form-problem" in answer.text) == (422, True)
