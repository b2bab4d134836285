"""The profile page."""

from __future__ import annotations

from robotether_server.db import Database, robots
from web_visitor import Browser


def test_everybody_has_a_profile(browser: Browser) -> None:
    """It says what to do first."""
    browser.log_in("ann")
    page = browser.ask("GET", "/profile").text
    assert "ssh-keygen -t ed25519" in page
    assert "No robot gives you a shell" in page


def test_ssh_configuration_of_the_robots_that_one_manages(
    browser: Browser, database: Database
) -> None:
    """With the host that the page was asked at."""
    with database.transaction() as tx:
        robot = robots.get(tx, "sim1")
        robots.set_state(tx, robot.id, "active")
        robots.set_shell(tx, robot.id, on=True)
    browser.log_in("root")
    page = browser.ask("GET", "/profile").text
    assert "Host sim1" in page
    assert "ProxyJump jump@robots.example:2222" in page
    assert "Add an SSH key above first" in page
