"""How full the disk is that a folder is on, for relay and recorder, and what others record of theirs."""

import os
import shutil
import time
from pathlib import Path
from typing import NamedTuple

# In compose.yaml's volume disk_record: the health check of mysql writes it.
DATABASE_RECORD = Path("/var/lib/robotether/disk/database")
# Maximum age of that.
DATABASE_CURRENT_S = 60.0


class DiskSpace(NamedTuple):
    """Bytes of a file system that are free, and its size. What is kept for root is nobody's here.

    `device`: its number in this machine as lsblk has it, such as 8:1; empty: unknown.
    """

    free: int
    size: int
    device: str = ""

    @property
    def free_part(self) -> float:
        """The part that is free, from 0 to 1."""
        return self.free / (self.size or 1)


def read_space(folder: Path) -> DiskSpace:
    """Ask the file system of a folder, which may hang; raise OSError."""
    usage, device = shutil.disk_usage(folder), folder.stat().st_dev
    return DiskSpace(usage.free, usage.used + usage.free, f"{os.major(device)}:{os.minor(device)}")


def recorded_space(file: Path, within_s: float = float("inf")) -> DiskSpace | None:
    """Return what a program recorded of its disk: bytes that are free and used, and perhaps the device.

    None: nothing within that time.
    """
    try:
        age_s = abs(time.time() - file.stat().st_mtime)
        free, used, *device = file.read_text(encoding="ascii").split()
        space = DiskSpace(int(free), int(free) + int(used), *device)
    except (OSError, TypeError, ValueError):
        return None
    return space if age_s <= within_s else None
