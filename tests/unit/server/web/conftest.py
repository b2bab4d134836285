"""An admin and a user in browsers."""

from __future__ import annotations

import pytest
from flask import Flask
from web_visitor import Browser


@pytest.fixture
def admin(app: Flask) -> Browser:
    """root, logged in."""
    browser = Browser(app.test_client())
    browser.log_in("root")
    return browser


@pytest.fixture
def ann(app: Flask) -> Browser:
    """A user who is no admin, logged in."""
    browser = Browser(app.test_client())
    browser.log_in("ann")
    return browser
