"""An admin and a user in browsers."""

import pytest
from web_visitor import Browser


@pytest.fixture
def admin(app):
    browser = Browser(app.test_client())
    browser.log_in("root")
    return browser


@pytest.fixture
def ann(app):
    browser = Browser(app.test_client())
    browser.log_in("ann")
    return browser
