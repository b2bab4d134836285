"""Where the versions of the agent are on a robot, and which of them is in use.

BASE/versions/VERSION-HASH12 is a virtual environment each, BASE/current a link to one of them, and
BASE/last-switch.json says how the last change ended. Written by robotether_agent.upgrade and installers.
"""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path

from robotether_agent.files import read_text, write_atomic
from robotether_agent.problems import StateUnusable, UpgradeFailed

UNIT = Path("/etc/systemd/system/robotether-agent.service")
COMMAND = "bin/robotether-agent"
NEW_UNIT = "share/robotether-agent/robotether-agent.service"


@dataclass(frozen=True)
class Report:
    """How a change went: `result` is running, done or rolled_back; `at` seconds since 1970."""

    result: str
    was: str
    wanted: str
    detail: str
    at: float
    took_s: float = 0.0


@dataclass(frozen=True)
class Layout:
    """The folder of all versions, and the unit file that systemd reads."""

    base: Path
    unit: Path = UNIT

    @property
    def lock(self) -> Path:
        """Held while a change is under way."""
        return self.base / ".switch.lock"

    def in_use(self) -> Path:
        """Return the version that `current` leads to."""
        try:
            return self.base / (self.base / "current").readlink()
        except OSError as error:
            raise UpgradeFailed(
                f"cannot switch: {self.base}/current leads to no version: {error.strerror}",
                advice=f"name a folder in versions/ of an installed agent, such as {self.base}/versions/NAME",
            ) from error

    def check(self, version: Path) -> None:
        """Raise UpgradeFailed unless `version` is one of this folder's, whole and startable."""
        command = version / COMMAND
        if version.parent != self.base / "versions" or not os.access(command, os.X_OK):
            raise UpgradeFailed(
                f"cannot switch to {version}: there is no {command} that can be run",
                advice="name a folder in versions/ that holds an installed agent",
            )

    def use(self, version: Path) -> bool:
        """Let `current` lead to `version` and install its unit file; tell whether that is another one."""
        link = self.base / ".current.new"
        try:
            link.unlink(missing_ok=True)
            link.symlink_to(Path("versions") / version.name)
            link.replace(self.base / "current")
        except OSError as error:
            raise StateUnusable(
                f"cannot change {self.base}/current: {error.strerror}",
                advice="run this with sudo, and see that the disk is neither full nor read-only",
            ) from error
        unit = read_text(version / NEW_UNIT)
        if unit is None or unit == read_text(self.unit):
            return False
        write_atomic(self.unit, unit, 0o644)
        return True

    def keep_only(self, *versions: Path) -> None:
        """Remove all other versions; one that cannot be removed is left."""
        for path in (self.base / "versions").iterdir():
            if path not in versions:
                shutil.rmtree(path, ignore_errors=True)

    def write(self, report: Report) -> None:
        """Write last-switch.json."""
        text = json.dumps(asdict(report), indent=1) + "\n"
        write_atomic(self.base / "last-switch.json", text, 0o644)
