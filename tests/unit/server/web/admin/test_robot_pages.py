"""The list of robots, its search, and the form that announces one."""

from __future__ import annotations

import pytest
from admin_visitor import fingerprint, join, send
from robotether_server.db import Database, robots
from robotether_server.db.robots import Report, Robot
from robotether_server.db.seen_robots import SeenRobot
from robotether_server.web.admin.robot_pages import RobotSearch
from web_visitor import Browser, audit_kinds

ROBOT = Robot(
    1, "00:1b:44:11:3a:b7", "lift-7", "active", 20000, 20001, "SHA256:x", {},
    report=Report("Turtle", "0.1.0", "198.51.100.9"),
)  # fmt: skip
SEEN = SeenRobot(ROBOT, online=True, since=None, level="manage", address="203.0.113.5")


MAC = "02:00:00:00:51:01"


@pytest.mark.parametrize(
    "words",
    ["", "lift", "LIFT 7", "1b:44", "00-1B-44", "001b44", "turtle", "203.0.113", "198.51.100.9"],
)
def test_a_robot_is_found_by_what_people_know_of_it(words: str) -> None:
    """Name, MAC in any spelling, host name, address; every word must fit."""
    assert RobotSearch(words).finds(SEEN)


@pytest.mark.parametrize(("words", "state"), [("lift crane", ""), ("", "offline"), ("", "pending")])
def test_what_does_not_fit_is_not_found(words: str, state: str) -> None:
    """Neither by a word nor by the state."""
    assert not RobotSearch(words, state).finds(SEEN)


@pytest.mark.parametrize("state", ["", "online", "active"])
def test_a_robot_is_found_by_its_state(state: str) -> None:
    """Online is a state beside the record's own."""
    assert RobotSearch("", state).finds(SEEN)


def test_list_shows_who_drives_and_what_is_stopped(
    admin: Browser, admin_database: Database
) -> None:
    """And finds the robots by it; the robot's own page says it too."""
    with admin_database.transaction() as tx:
        one, two = (robots.get(tx, name).id for name in ("sim1", "sim2"))
        tx.change(
            "INSERT INTO control_leases (robot_id, fence, user_name, since) "
            "VALUES (%s, 1, 'ben', '2026-01-31 12:03')",
            (one,),
        )
        tx.change(
            "INSERT INTO robot_stops (robot_id, by_name, stopped_at) "
            "VALUES (%s, 'zoe', '2026-01-31 12:04')",
            (two,),
        )
    page = admin.ask("GET", "/admin/robots").text
    assert 'title="since 2026-01-31 12:03 UTC">ben drives<' in page
    assert 'title="by zoe, 2026-01-31 12:04 UTC">Stopped<' in page
    for state, name in (("driven", "sim1"), ("stopped", "sim2")):
        page = admin.ask("GET", f"/admin/robots?state={state}").text
        assert (page.count('data-testid="row-'), f'data-testid="row-{name}"' in page) == (1, True)
    assert "ben drives" in admin.ask("GET", "/admin/robots/sim1").text
    assert "Stopped by zoe" in admin.ask("GET", "/admin/robots/sim2").text


def test_list_shows_what_the_search_finds(admin: Browser) -> None:
    """And how many of how many."""
    page = admin.ask("GET", "/admin/robots?q=sim2").text
    assert "row-sim2" in page
    assert "row-sim1" not in page
    assert "1 of 2" in page


def test_a_search_that_finds_nothing_leads_back(admin: Browser) -> None:
    """To all robots."""
    page = admin.ask("GET", "/admin/robots?q=ghost").text
    assert "None of the 2 robots matches" in page
    assert 'href="/admin/robots">Show all' in page


def test_an_empty_fleet_says_what_to_do_first(admin: Browser, database: Database) -> None:
    """With a link for each way."""
    with database.transaction() as tx:
        for name in ("sim1", "sim2"):
            robots.remove(tx, robots.get(tx, name).id)
    page = admin.ask("GET", "/admin/robots").text
    assert "There is no robot yet" in page
    assert "/admin/join-tokens" in page


def test_what_an_unknown_robot_calls_itself_is_text(admin: Browser, program: Browser) -> None:
    """A host name is anybody's; it becomes no markup, on no page."""
    assert join(program, "02:00:00:00:51:77", 7, "<script>alert(1)</script>").status_code == 202
    for path in ("/admin/robots", "/admin/pending", "/admin/robots/robot-005177", "/admin/audit"):
        page = admin.ask("GET", path).text
        assert "&lt;script&gt;alert(1)" in page, path
        assert "<script>alert" not in page, path


def test_a_robot_is_announced(admin: Browser, database: Database) -> None:
    """Its page follows, and its row is there."""
    answer = send(admin, "/admin/add-robot", name="lift", mac="00-1B-44-11-3A-B7")
    assert (answer.status_code, answer.location) == (303, "/admin/robots/lift")
    assert "Robot lift is announced" in admin.ask("GET", "/admin/robots/lift").text
    with database.transaction() as tx:
        assert robots.get(tx, "lift").mac == "00:1b:44:11:3a:b7"
    assert ("robot_added", "root", "198.51.100.7") in audit_kinds(database)


@pytest.mark.parametrize(
    ("name", "mac", "sentence"),
    [
        ("", "00:1b:44:11:3a:b7", "fill in Name"),
        ("lift", "rubbish", "no MAC address"),
        ("-x-", "00:1b:44:11:3a:b7", "a name has a-z"),
        ("sim1", "00:1b:44:11:3a:b7", "name sim1"),
        ("lift", "06:00:00:00:00:01", "locally administered"),
    ],
)
def test_a_wrong_form_comes_back_filled_in(
    admin: Browser, name: str, mac: str, sentence: str
) -> None:
    """With the sentence that says what is wrong."""
    answer = send(admin, "/admin/add-robot", name=name, mac=mac)
    assert answer.status_code >= 400
    assert sentence in answer.text
    assert f'value="{mac}"' in answer.text


def test_a_local_mac_may_be_allowed(admin: Browser) -> None:
    """By a box that says what it is."""
    answer = send(admin, "/admin/add-robot", name="lift", mac="06:00:00:00:00:01", local_mac="yes")
    assert answer.status_code == 303


def test_page_tells_all_that_is_known(
    admin: Browser, program: Browser, admin_database: Database
) -> None:
    """Machine, key, ports, sessions, audit and grants."""
    join(program, MAC, 1)
    with admin_database.transaction() as tx:
        robot = robots.get(tx, "sim1")
        tx.change(
            "INSERT INTO robot_sessions (robot_id, ended_at, end_code, address, agent_version) "
            "VALUES (%s, NOW(), 'link_lost', '203.0.113.5', '0.2.0')",
            (robot.id,),
        )
    page = admin.ask("GET", "/admin/robots/sim1").text
    for text in (MAC, "turtle", str(robot.ros_port), "203.0.113.5", "robot_pending"):
        assert text in page
    assert 'title="link_lost">its connection ended<' in page
    assert 'data-testid="grant-ann"' in page
    assert fingerprint(1) in page.replace("</span><span>", "")


def test_page_warns_of_a_rosbridge_that_its_network_reaches(
    admin: Browser, admin_database: Database
) -> None:
    """While the robot is online and says so; what a session said that is over may be mended."""
    for ended_at, exposed, warns in (
        ("NULL", "FALSE", False),
        ("NULL", "TRUE", True),
        ("NOW()", "TRUE", False),
    ):
        with admin_database.transaction() as tx:
            tx.change(
                "INSERT INTO robot_sessions (robot_id, address, ros_exposed, ended_at) "
                f"VALUES (%s, '', {exposed}, {ended_at})",
                (robots.get(tx, "sim1").id,),
            )
        page = admin.ask("GET", "/admin/robots/sim1").text
        assert ('data-testid="ros-exposed"' in page) == warns
        assert ("<code>address:=127.0.0.1</code>" in page) == warns


def test_page_says_what_to_do_next(admin: Browser, program: Browser) -> None:
    """A robot that has not joined needs its agent, one that waits needs an admin."""
    assert "has not joined yet" in admin.ask("GET", "/admin/robots/sim1").text
    join(program, MAC, 1)
    assert "compare its key" in admin.ask("GET", "/admin/robots/sim1").text


def test_unknown_robot_leads_back(admin: Browser) -> None:
    """404, with a way to the list."""
    answer = admin.ask("GET", "/admin/robots/ghost")
    assert (answer.status_code, "cannot show robot ghost" in answer.text) == (404, True)
    assert 'href="/admin/robots">Back' in answer.text


def test_robot_called_as_a_page_is_reached(admin: Browser) -> None:
    """No name that a robot may have is taken by a page of the admins."""
    for number, name in enumerate(("new", "add", "pending")):
        mac = f"00:1b:44:11:3a:0{number}"
        assert send(admin, "/admin/add-robot", name=name, mac=mac).status_code == 303
        page = admin.ask("GET", f"/admin/robots/{name}").text
        assert f'<h1 data-testid="robot-name">{name}</h1>' in page
