"""What an admin changes of a robot by a form."""

from __future__ import annotations

import pytest
from admin_visitor import send
from robotether_server.db import Database, robots
from robotether_server.db.robots import Robot
from web_visitor import Browser


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
