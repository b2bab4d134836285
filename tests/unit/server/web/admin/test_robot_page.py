"""The page of one robot."""

from __future__ import annotations

from admin_visitor import fingerprint, join, send
from robotether_server.db import Database, robots
from web_visitor import Browser

MAC = "02:00:00:00:51:01"


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
