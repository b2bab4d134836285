"""The page with the ages of backups."""

import time
from dataclasses import replace

import pytest


@pytest.fixture
def said(app, admin, tmp_path):
    def read(folder="", **record):
        shown = replace(app.extensions["robotether"], backup_record=tmp_path / folder)
        app.extensions["robotether"] = shown
        for name, text in record.items():
            (tmp_path / name).write_text(f"{text}\n")
        return admin.ask("GET", "/admin/backups").text

    return read


def test_ages_are_of_the_backup_and_of_its_copy_or_unknown(said):
    now = int(time.time())
    assert "No backup has been made on this machine yet." in said()
    page = said(made=now - 7200)
    assert "</time>, 2 h 0 min ago" in page
    assert 'another place: <span class="soft">never</span>.' in page
    assert "</time>, 26 h 0 min ago" in said(copied=now - 93600)
    assert "is not known here" in said("missing")
    assert "in the future by this machine's clock" in said(made=now + 3600)
