"""How full the disk is that a folder is on, for relay and recorder."""

import shutil
from pathlib import Path
from typing import NamedTuple


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
