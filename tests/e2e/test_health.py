"""The page Health: what is now, with the stack as it is, and charts of answers that the tests give."""

from __future__ import annotations

import re

from playwright.sync_api import Page, expect
from stack import Stack

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
