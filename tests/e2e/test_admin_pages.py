"""An admin in a real browser lets robots and people in, over the whole stack."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import pytest
from pages import expect_no_sideways_scroll, log_in, open_page
from playwright.sync_api import Page, expect
from robot_key import RobotKey
from stack import Stack

PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
COPIES = {"permissions": ["clipboard-read", "clipboard-write"]}


def _state(stack: Stack, name: str) -> list[list[str]]:
    return stack.sql(f"SELECT state, fingerprint FROM robots WHERE name = '{name}'")


def _done(page: Page, message: str) -> None:
    expect(page.get_by_test_id("done")).to_have_text(message)


def _remove(page: Page, stack: Stack, name: str) -> None:
    """Take a robot of these tests away through its page."""
    open_page(page, stack, f"/admin/robots/{name}")
    page.get_by_test_id("remove").click()
    page.get_by_test_id("deed-do").click()
    _done(page, f"Robot {name} is removed.")


def test_a_robot_that_waits_is_approved_under_another_name(
    page: Page, stack: Stack, tmp_path: Path
) -> None:
    """Its key stands there to be compared; from then on the robot is told that it is in."""
    mac, key = "00:00:5e:00:53:11", RobotKey(stack, tmp_path, "turtle")
    assert key.join(mac)[0] == 202
    open_page(page, stack, "/admin/robots")
    page.get_by_test_id("waiting-count").click()
    card = page.get_by_test_id("waiting-robot-005311")
    assert card.get_by_test_id("fingerprint").text_content() == key.fingerprint
    expect(card).to_contain_text("turtle")
    card.get_by_label("Name").fill("turtle")
    card.get_by_test_id("approve-robot-005311").click()
    _done(page, "Robot turtle is approved. It connects by itself within a minute.")
    assert _state(stack, "turtle") == [["active", key.fingerprint]]
    status, answer = key.join(mac)
    assert (status, answer["robot"]) == (200, "turtle")
    _remove(page, stack, "turtle")


def test_a_rejected_robot_may_ask_again_when_an_admin_says_so(
    page: Page, stack: Stack, tmp_path: Path
) -> None:
    """Until then its key is refused."""
    mac, key = "00:00:5e:00:53:12", RobotKey(stack, tmp_path, "stranger")
    assert key.join(mac)[0] == 202
    open_page(page, stack, "/admin/pending")
    page.get_by_test_id("reject-robot-005312").click()
    expect(page.get_by_test_id("effects")).to_contain_text(key.fingerprint)
    page.get_by_test_id("deed-do").click()
    _done(page, "The key that waited for robot robot-005312 is rejected.")
    status, answer = key.join(mac)
    assert (status, answer["code"]) == (403, "key_rejected")
    page.get_by_role("link", name="Let the key of stranger ask again").click()
    page.get_by_test_id("deed-do").click()
    _done(page, "The key may ask again.")
    assert key.join(mac)[0] == 202
    _remove(page, stack, "robot-005312")


def test_a_robot_is_announced_and_renamed(page: Page, stack: Stack) -> None:
    """A name that is taken comes back in the form."""
    open_page(page, stack, "/admin/robots")
    page.get_by_test_id("add-robot").click()
    page.get_by_label("Name").fill("lift")
    page.get_by_label("MAC address").fill("00-00-5E-00-53-13")
    page.get_by_test_id("add-submit").click()
    page.get_by_test_id("rename").click()
    page.get_by_label("New name").fill("sim1")
    page.get_by_test_id("deed-do").click()
    expect(page.get_by_test_id("form-problem")).to_contain_text("sim1")
    page.get_by_label("New name").fill("crane")
    page.get_by_test_id("deed-do").click()
    _done(page, "Robot lift is now crane.")
    expect(page.get_by_test_id("robot-name")).to_have_text("crane")
    _remove(page, stack, "crane")


def test_a_new_user_sees_a_robot_with_the_grant(page: Page, stack: Stack) -> None:
    """The password that the page made lets the user in; the grant opens the robot, and its end closes it."""
    open_page(page, stack, "/admin/users")
    page.get_by_label("Name").fill("petra")
    page.get_by_test_id("user-add").click()
    password = page.get_by_test_id("secret").text_content() or ""
    page.get_by_test_id("secret-done").click()
    browser = page.context.browser
    assert browser is not None
    context = browser.new_context(ignore_https_errors=True)
    try:
        petra = context.new_page()
        log_in(petra, stack, "petra", password)
        expect(petra.get_by_test_id("fleet-empty")).to_be_visible()
        page.get_by_label("Robot", exact=True).fill("sim2")
        page.get_by_label("May").select_option("observe")
        page.get_by_test_id("grant-submit").click()
        _done(page, "User petra may observe robot sim2.")
        expect(petra.get_by_test_id("robot-card-sim2")).to_be_visible(timeout=10_000)
        page.get_by_role("link", name="Take the grant of petra for sim2 away").click()
        page.get_by_test_id("deed-do").click()
        _done(page, "User petra has no grant for robot sim2 any more.")
        expect(petra.get_by_test_id("robot-card-sim2")).to_have_count(0, timeout=10_000)
    finally:
        context.close()
        open_page(page, stack, "/admin/users/petra/remove")
        page.get_by_test_id("deed-do").click()


@pytest.mark.parametrize("context", [COPIES], indirect=True, ids=["clipboard"])
def test_an_install_line_lets_a_robot_in(page: Page, stack: Stack, tmp_path: Path) -> None:
    """The button copies it, and its token is one that a robot joins with."""
    open_page(page, stack, "/admin/robots")
    page.get_by_test_id("invite").click()
    page.get_by_label("Name").fill("hall north")
    page.get_by_test_id("token-make").click()
    line = page.get_by_test_id("install-line").text_content() or ""
    page.get_by_role("button", name="Copy").first.click()
    expect(page.get_by_role("button", name="Copied")).to_be_visible()
    assert page.evaluate("navigator.clipboard.readText()") == line
    words = shlex.split(line)
    assert words[0] == "curl"
    assert f"https://localhost:{stack.https_port}/join.sh" in words
    key = RobotKey(stack, tmp_path, "clone")
    body = {
        "mac": "00:00:5e:00:53:14",
        "public_key": key.public,
        "hostname": "clone",
        "agent_version": "0.1.0",
        "token": words[-1],
    }
    status, answer = stack.request("POST", "/api/v1/join", body)
    assert (status, answer["state"]) == (200, "active")
    open_page(page, stack, "/admin/join-tokens")
    expect(page.get_by_test_id("join-tokens")).to_contain_text("0 of 1")
    page.get_by_role("link", name="Delete join token hall north").click()
    page.get_by_test_id("deed-do").click()
    _remove(page, stack, str(answer["robot"]))


PAGES = (
    "/", "/admin/robots", "/admin/add-robot", "/admin/pending", "/admin/robots/sim1", "/admin/robots/sim1/remove",
    "/admin/robots/sim1/ports", "/admin/users", "/admin/users/admin", "/admin/join-tokens", "/admin/tokens",
    "/admin/audit", "/profile", "/profile/password", "/admin/robots/nobody",
)  # fmt: skip


def _with(**options: Any) -> dict[str, Any]:
    return {**PHONE, **options}


@pytest.mark.parametrize(
    "context",
    [_with(), _with(java_script_enabled=False), _with(viewport={"width": 320, "height": 640})],
    indirect=True,
    ids=["phone", "no script", "small phone"],
)
def test_no_page_scrolls_sideways_on_a_phone(page: Page, stack: Stack, tmp_path: Path) -> None:
    """With and without the pages' scripts; every page has its heading and the menu."""
    key = RobotKey(stack, tmp_path, "a-host-name-that-is-as-long-as-host-names-may-be-" + "x" * 14)
    assert key.join("00:00:5e:00:53:15")[0] == 202
    for path in PAGES:
        open_page(page, stack, path)
        expect(page.get_by_role("heading", level=1)).to_have_count(1)
        expect(page.get_by_role("navigation", name="Main")).to_be_visible()
        expect_no_sideways_scroll(page)
    _remove(page, stack, "robot-005315")
