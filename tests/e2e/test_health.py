"""The page Health: what is now, with the stack as it is, and charts of answers that the tests give."""

from __future__ import annotations

import re

from pages import expect_no_sideways_scroll
from playwright.sync_api import Page, Route, expect
from stack import Stack

TIMES = list(range(1_800_000_000, 1_800_000_600, 60))
CHART = {
    "name": "guard_stops",
    "unit": "count",
    "lines": [
        {"name": "lost", "values": [2.0, *[None] * 9]},
        {"name": "person", "values": [0.0] * 10},
    ],
}

EXPECTED = {
    "cell main": "Good",
    "recorder of main": "Good",
    "sshd": "Good",
    "prometheus": "Unknown",
}


def test_parts_are_good_and_what_needs_prometheus_is_unknown(page: Page, stack: Stack) -> None:
    page.goto(f"{stack.url}/admin/health")
    expect(page.get_by_test_id("health-feed")).to_have_text("Live")
    rows = page.get_by_test_id("health-part")
    for name, state in EXPECTED.items():
        expect(rows.filter(has_text=re.compile(rf"^\s*{name}"))).to_contain_text(state)
    expect(page.get_by_test_id("alerts-state")).to_contain_text("unknown")
    expect(page.get_by_test_id("history-state")).to_contain_text("COMPOSE_PROFILES=metrics")


def test_history_is_chosen_with_the_keyboard_and_says_what_it_does_not_know(
    page: Page, stack: Stack
) -> None:
    asked: list[str] = []

    def answer(route: Route) -> None:
        asked.append(route.request.url.partition("?")[2])
        route.fulfill(json={"times": TIMES, "charts": [CHART]})

    page.route("**/api/v1/health/history*", answer)
    page.set_viewport_size({"width": 390, "height": 844})
    page.goto(f"{stack.url}/admin/health")
    page.get_by_test_id("range-day").press("Enter")
    page.get_by_test_id("health-robot").select_option("sim1")
    expect(page.get_by_test_id("history-state")).to_have_text("sim1, the last day.")
    assert asked[-1] == "range=day&robot=sim1"
    lines = page.get_by_test_id("chart-guard_stops").locator("li")
    expect(lines).to_have_text(
        [
            "driver lost: now unknown, lowest 2, highest 2, unknown for 90 % of the time",
            "by people: now 0, lowest 0, highest 0",
        ]
    )
    expect(page.get_by_test_id("chart-guard_stops").locator("canvas")).to_be_visible()
    expect_no_sideways_scroll(page)
