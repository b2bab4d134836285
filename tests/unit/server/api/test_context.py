"""What the handlers of one application share."""

from __future__ import annotations

import datetime as dt

from flask import Flask
from robotether_server.api.context import context
from robotether_server.db.credentials import Lifetime
from robotether_server.settings import WebSettings
from robotether_server.web import create_app


def test_each_application_has_its_own(app: Flask, web_settings: WebSettings) -> None:
    """Two in one process, as in these tests, do not mix."""
    other = create_app(web_settings)
    with app.app_context():
        ours = context()
    with other.app_context():
        assert context() is not ours
        assert context().login_lifetime == Lifetime(dt.timedelta(hours=12), dt.timedelta(hours=4))
