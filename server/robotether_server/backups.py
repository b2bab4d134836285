"""Reads when the last backup was made and copied, as tools/backup records it in a volume of this machine.

Used by web for its page and by the relay for its metrics. The database has no such record: it would come back with a
restore, and speak of backups that the new machine does not have.
"""

import datetime as dt
from dataclasses import dataclass
from pathlib import Path

# In compose.yaml's volume backup_record.
RECORD = Path("/var/lib/robotether/backups")


@dataclass(frozen=True)
class LastBackup:
    """When it was made, and when one was copied elsewhere; None: never on this machine."""

    made_at: dt.datetime | None
    copied_at: dt.datetime | None


def last_backup(folder: Path) -> LastBackup | None:
    """Return what is recorded; None: that is not known, as where there is no such volume."""
    if not folder.is_dir():
        return None
    try:
        return LastBackup(_read(folder / "made"), _read(folder / "copied"))
    except (OSError, OverflowError, ValueError):
        return None


def age_s(timestamp: dt.datetime | None) -> float:
    """Return the age of a backup; infinite if there is none."""
    if timestamp is None:
        return float("inf")
    return (dt.datetime.now(dt.UTC) - timestamp).total_seconds()


def _read(file: Path) -> dt.datetime | None:
    try:
        return dt.datetime.fromtimestamp(int(file.read_text(encoding="ascii")), dt.UTC)
    except FileNotFoundError:
        return None
