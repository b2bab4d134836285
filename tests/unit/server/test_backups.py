"""What tools/backup has recorded."""

import datetime as dt

import pytest
from robotether_server.backups import LastBackup, last_backup

NOON = dt.datetime(2026, 1, 31, 12, tzinfo=dt.UTC)


def test_no_backup_and_no_copy_are_known(tmp_path):
    assert last_backup(tmp_path) == LastBackup(None, None)
    (tmp_path / "made").write_text(f"{NOON.timestamp():.0f}\n")
    assert last_backup(tmp_path) == LastBackup(NOON, None)


@pytest.mark.parametrize("text", ["", "soon", "9" * 30])
def test_what_cannot_be_read_is_unknown(tmp_path, text):
    """It is not the same as no backup, nor is a deployment without such a volume, such as Swarm's."""
    assert last_backup(tmp_path / "missing") is None
    (tmp_path / "made").write_text(text)
    assert last_backup(tmp_path) is None
