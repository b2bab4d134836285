"""The pages of requests for help and the wall: to whom they are offered, and what they give to their scripts."""

import html
import json
import re

import pytest


@pytest.fixture
def visitors(browser, ann, manager, admin):
    """A visitor of each level: olga observes sim1, ann drives it, may manages it, root is admin."""
    browser.log_in("olga")
    return {"observe": browser, "drive": ann, "manage": manager, "admin": admin}


@pytest.mark.parametrize(
    ("level", "has_queue", "may_supervise"),
    [
        ("observe", False, False),
        ("drive", True, False),
        ("manage", True, True),
        ("admin", True, True),
    ],
)
def test_everybody_is_led_to_the_pages_that_concern_them(visitors, level, has_queue, may_supervise):
    """Who only watches gets no offers, and only who manages a robot supervises; the drive page has the same menu."""
    visitor = visitors[level]
    for path in ("/", "/robots/sim1"):
        page = visitor.ask("GET", path).text
        assert 'data-testid="menu-wall"' in page
        assert ('data-testid="menu-queue"' in page) is has_queue
    assert ('data-testid="help-ask"' in page) is has_queue
    assert 'data-testid="help-list"' in page
    queue = visitor.ask("GET", "/queue").text
    assert ("You may drive no robot" in queue) is not has_queue
    assert ('href="/queue/supervise"' in queue) is may_supervise
    supervised = visitor.ask("GET", "/queue/supervise")
    assert supervised.status_code == (200 if may_supervise else 403)
    assert ("This page is for managers of robots." in supervised.text) is not may_supervise


def test_wall_names_only_robots_that_its_user_may_see(visitors):
    for level, robots in (
        ("observe", {"sim1": "observe"}),
        ("drive", {"sim1": "drive"}),
        ("admin", {"sim1": "manage", "sim2": "manage"}),
    ):
        page = visitors[level].ask("GET", "/wall").text
        [found] = re.findall(r"data-robots='([^']*)'", page)
        facts = json.loads(html.unescape(found))
        assert {name: fact["level"] for name, fact in facts.items()} == robots
        assert 'data-most="20"' in page
