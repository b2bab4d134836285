"""Fixtures of the end-to-end tests: Debian's Chromium, driven by Playwright, in front of the running stack."""

import re

import pytest
from half_closed import pytest_configure, pytest_sessionfinish  # noqa: F401 - hooks of pytest
from pages import be_logged_in, chromium
from playwright.sync_api import expect, sync_playwright
from stack import ROOT

# What a page shows comes through several processes, which share two processors with other tests.
expect.set_options(timeout=10_000)

DESKTOP = {"viewport": {"width": 1280, "height": 800}}
FAILED = pytest.StashKey[bool]()


@pytest.fixture(scope="module")
def browser():
    """A headless Chromium; only for a module, as Playwright keeps a loop running that asyncio tests cannot share."""
    with sync_playwright() as playwright:
        launched = chromium(playwright)
        yield launched
        launched.close()


@pytest.fixture
def context(browser, request):
    """A desktop's browser, or what the test's parameter says; it accepts the self-signed certificate."""
    options = getattr(request, "param", DESKTOP)
    made = browser.new_context(ignore_https_errors=True, **options)
    yield made
    made.close()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Let the fixtures know how the test ended."""
    report = yield
    if report.failed:
        item.stash[FAILED] = True
    return report


@pytest.fixture
def page(stack, context, request):
    """A page, not yet opened, of the admin; a console error or a failing test leaves a picture in tests/artifacts."""
    be_logged_in(context, stack)
    opened = context.new_page()
    errors = []
    opened.on("pageerror", lambda error: errors.append(str(error)))
    yield opened
    if errors or FAILED in request.node.stash:
        name = re.sub(r"\W+", "_", request.node.name)
        opened.screenshot(path=ROOT / "tests" / "artifacts" / f"{name}.png")
    assert errors == [], f"the page raised {errors}"
