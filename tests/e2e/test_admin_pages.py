"""An admin in a real browser lets robots and people in and gives rights, over the whole stack."""

import shlex

import pytest
from pages import open_page
from playwright.sync_api import expect
from robot_key import RobotKey

COPIES = {"permissions": ["clipboard-read", "clipboard-write"]}


@pytest.fixture(autouse=True)
def nothing_stays(stack):
    """Robots and people that a test leaves behind when it fails are gone: others could not make them anew."""
    before = _records(stack)
    yield
    for kind, name in _records(stack) - before:
        stack.admin.remove(kind, name)


def _records(stack):
    listed = {kind: stack.admin.ask("GET", f"/{kind}")[kind] for kind in ("robots", "users")}
    return {(kind, item["name"]) for kind, found in listed.items() for item in found}


def _done(page, message):
    expect(page.get_by_test_id("done")).to_have_text(message)


def _do(page, stack, path, message, **fields):
    """Say yes on a page that asks, with its fields filled in by their labels."""
    page.goto(f"{stack.url}{path}")
    for label, value in fields.items():
        page.get_by_label(label.replace("_", " ")).fill(value)
    page.get_by_test_id("deed-do").click()
    _done(page, message)


def _remove(page, stack, name):
    _do(page, stack, f"/admin/robots/{name}/remove", f"Robot {name} is removed.")


def test_a_page_of_a_robot_that_is_renamed_leads_to_the_new_name(page, stack):
    stack.robotether("robot", "add", "lift", "--mac", "00:00:5e:00:53:13")
    open_before = page.context.new_page()
    open_page(open_before, stack, "/robots/lift")
    _do(page, stack, "/admin/robots/lift/rename", "Robot lift is now crane.", New_name="crane")
    expect(page.get_by_test_id("robot-name")).to_have_text("crane")
    expect(open_before.get_by_test_id("state")).to_contain_text("called crane now", timeout=15_000)
    # Another robot may be called lift by now.
    open_before.get_by_test_id("drawer-open").click()
    expect(open_before.get_by_test_id("driving-help")).to_be_visible()
    expect(open_before.get_by_test_id("record")).to_be_hidden()
    open_before.get_by_test_id("state-action").click()
    expect(open_before).to_have_url(f"{stack.url}/robots/crane")
    open_before.close()
    _remove(page, stack, "crane")


@pytest.mark.parametrize("context", [COPIES], indirect=True, ids=["clipboard"])
def test_a_robot_is_added_in_three_steps(page, stack, tmp_path):
    """The button on the fleet page leads there and copies the line; the page shows who waits and who arrives."""
    page.goto(f"{stack.url}/")
    page.get_by_test_id("add-robot").click()
    page.get_by_label("Name (optional)").fill("clone")
    page.get_by_test_id("token-make").click()
    line = page.get_by_test_id("install-line").text_content() or ""
    page.get_by_role("button", name="Copy").first.click()
    expect(page.get_by_role("button", name="Copied")).to_be_visible()
    assert page.evaluate("navigator.clipboard.readText()") == line
    words = shlex.split(line)
    assert words[0] == "curl"
    assert f"https://localhost:{stack.https_port}/join.sh" in words
    assert words[-4:-1] == ["--name", "clone", "--token"]
    expect(page.get_by_test_id("waits")).to_be_visible()
    stranger = RobotKey(stack, tmp_path, "stranger")
    assert stranger.join("00:00:5e:00:53:16")[0] == 202
    typed = page.get_by_test_id("waiting-robot-005316").get_by_label("Name")
    typed.fill("kept")
    typed.blur()
    # To the terminal; nothing moves under a pointer that is about to approve.
    page.mouse.move(0, 0)
    key = RobotKey(stack, tmp_path, "clone")
    status, answer = key.join("00:00:5e:00:53:14", name="clone", token=words[-1])
    assert (status, answer["state"], answer["robot"]) == (200, "active", "clone")
    arrived = page.get_by_test_id("arrived-clone")
    expect(arrived).to_contain_text("It has joined and connects within a minute.")
    expect(page.get_by_test_id("waits")).to_have_count(0)
    expect(typed).to_have_value("kept")
    arrived.get_by_test_id("arrived-open").click()
    expect(page.get_by_test_id("robot-name")).to_have_text("clone")
    _remove(page, stack, "clone")
    _remove(page, stack, "robot-005316")
