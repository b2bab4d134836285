"""The documents are a site of the stack: readable without a login, searchable, and from no other host."""

from __future__ import annotations

import re

from playwright.sync_api import Page, expect
from stack import Stack


def test_documents_are_found_by_search_and_load_nothing_from_elsewhere(
    page: Page, stack: Stack
) -> None:
    """The policy of the pages stops no script of theirs: search runs in one."""
    complaints: list[str] = []
    hosts: set[str] = set()
    page.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)
    page.on("request", lambda request: hosts.add(re.sub(r"^\w+:/*([^/]*).*", r"\1", request.url)))
    page.goto(f"{stack.url}/docs/")
    page.get_by_role("textbox", name="Search").press_sequentially("deadman")
    found = page.locator(".md-search-result__item").first
    expect(found).to_contain_text("deadman_ms", timeout=10_000)
    found.get_by_role("link").first.click()
    expect(page).to_have_url(re.compile(rf"{stack.url}/docs/\w+/"))
    assert complaints == []
    assert hosts == {stack.url.removeprefix("https://")}


def test_reference_comes_from_the_code(page: Page, stack: Stack) -> None:
    """Settings, close codes, operations and the API stand in it as the code has them."""
    for path, word in (
        ("reference/server-settings/", "LOGIN_IDLE_H"),
        ("reference/codes/", "lease_held"),
        ("reference/operations/", "call_service"),
        ("reference/api/", "POST /api/v1/tickets"),
    ):
        page.goto(f"{stack.url}/docs/{path}")
        expect(page.get_by_role("main")).to_contain_text(word)
