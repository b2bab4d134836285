"""The page with the ages of backups."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from flask import Flask
from web_visitor import Browser


@pytest.fixture
def said(app: Flask, admin: Browser, tmp_path: Path) -> Callable[..., str]:
    """Record these times, as tools/backup does, and return the page."""

    def read(folder: str = "", **record: object) -> str:
        shown = replace(app.extensions["robotether"], backup_record=tmp_path / folder)
        app.extensions["robotether"] = shown
        for name, text in record.items():
            (tmp_path / name).write_text(f"{text}\n")
        return admin.ask("GET", "/admin/backups").text

    return read


def test_ages_are_of_the_backup_and_of_its_copy(said: Callable[..., str]) -> None:
    """Without a copy there is none."""
    now = int(time.time())
    page = said(made=now - 7200)
    assert "</time>, 2 h 0 min ago" in page
    assert 'another place: <span class="soft">never</span>.' in page
    assert "</time>, 26 h 0 min ago" in said(copied=now - 93600)


def test_none_and_unknown_are_said(said: Callable[..., str]) -> None:
    """They are not the same."""
    assert "No backup has been made on this machine yet." in said()
    assert "is not known here" in said("missing")


def test_clock_that_was_set_back_gives_no_age(said: Callable[..., str]) -> None:
    """A backup of the future is not new."""
    assert "in the future by this machine's clock" in said(made=int(time.time()) + 3600)
