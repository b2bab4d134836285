"""An admin in a browser."""

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
