"""How full the disk is that a folder is on, for relay and recorder, and what others record of theirs."""

import shutil
import time
from pathlib import Path
from typing import NamedTuple

# In compose.yaml's volume disk_record: the health check of mysql writes it.
DATABASE_RECORD = Path("/var/lib/robotether/disk/database")
# Maximum age of that.
DATABASE_CURRENT_S = 60.0


class DiskSpace(NamedTuple):
    """Bytes of a file system that are free, and its size. What is kept for root is nobody's here."""

    free: int
    size: int

    @property
    def free_part(self) -> float:
        """The part that is free, from 0 to 1."""
        return self.free / (self.size or 1)


def read_space(folder: Path) -> DiskSpace:
    """Ask the file system of a folder, which may hang; raise OSError."""
    usage = shutil.disk_usage(folder)
    return DiskSpace(usage.free, usage.used + usage.free)


def recorded_space(file: Path, within_s: float = float("inf")) -> DiskSpace | None:
    """Return what a program recorded of its disk, as bytes that are free and used; None: nothing within that time."""
    try:
        age_s = abs(time.time() - file.stat().st_mtime)
        free, used = map(int, file.read_text(encoding="ascii").split())
    except (OSError, ValueError):
        return None
    return DiskSpace(free, free + used) if age_s <= within_s else None
