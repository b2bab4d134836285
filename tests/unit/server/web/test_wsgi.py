"""What gunicorn calls."""

from __future__ import annotations

import os

import pytest
from robotether_server.problems import SettingsError
from robotether_server.web.wsgi import make_app

ENVIRON = {
    "DB_USER": "web",
    "DB_PASSWORD": "x",
    "TICKET_KEY": "t" * 32,
    "WEB_SECRET_KEY": "w" * 32,
}


def test_application_is_made_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """It answers before the database does."""
    for name, value in ENVIRON.items():
        monkeypatch.setenv(name, value)
    assert make_app().test_client().get("/healthz").text == "ok\n"


def test_wrong_environment_stops_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the sentence of the settings."""
    for name in [*ENVIRON, *(f"{name}_FILE" for name in ENVIRON)]:
        monkeypatch.delenv(name, raising=False)
    assert "DB_USER" not in os.environ
    with pytest.raises(SettingsError):
        make_app()
