"""Adds PyAV, which encodes H.264, to the installed version whose Python runs it: `robotether-agent install-video`.

A robot works without it, so the installers run it last and continue when it fails. If another installed version has
the locked PyAV, or pip cannot get it, that one is linked, which spares the robot's line and disk.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from robotether_agent.install import pip_install

LOCK = Path("share/robotether-agent/requirements.video.txt")
# Without a network pip gives up after half a minute.
OPTIONS = ("--no-cache-dir", "--timeout", "15", "--retries", "1")
# What PyAV is in a folder of modules. The last one names the version, and is put in place last.
TREES = ("av.libs", "av", "av-{version}.dist-info")
# Size in MB of PyAV and of its wheel, rounded up.
NEEDED_MB = 150


def install_video(folder: Path, options: Sequence[str]) -> str:
    """Add PyAV to the version in `folder`, and return why that is impossible, or the empty text."""
    lock = folder / LOCK
    site = folder / "lib" / f"python3.{sys.version_info.minor}" / "site-packages"
    if _versions(site):
        return ""
    if not lock.exists():
        return f"no installer made {folder}; install the agent's extra [video] where it is"
    if not os.access(site, os.W_OK):
        return f"this user may not write in {site}; run this with sudo"
    try:
        if _link(site, lock.read_text()):
            return ""
        reason = _download(folder, lock, options)
        return reason if reason and not _link(site) else ""
    finally:
        # Neither pip nor links are on the disk before.
        os.sync()


def _versions(site: Path) -> list[str]:
    first, last = TREES[-1].split("{version}")
    return [path.name[len(first) : -len(last)] for path in site.glob(f"{first}*{last}")]


def _link(site: Path, lock: str | None = None) -> bool:
    """Link PyAV of another version, of those that are in the lock if one is given; return whether there is any."""
    folder = site.parents[2]
    for other in folder.parent.glob(f"*/{site.relative_to(folder)}"):
        for version in _versions(other):
            if lock is None or f"av=={version} " in lock:
                # Some file systems have no links.
                with suppress(OSError):
                    for tree in (tree.format(version=version) for tree in TREES):
                        # Left by a power cut.
                        shutil.rmtree(site / tree, ignore_errors=True)
                        shutil.copytree(other / tree, site / tree, copy_function=os.link)
                    return True
    return False


def _download(folder: Path, lock: Path, options: Sequence[str]) -> str:
    """Return why pip fails, in its last words, or the empty text."""
    free_mb = shutil.disk_usage(folder).free // 1_000_000
    if free_mb < NEEDED_MB:
        return f"{folder} has {free_mb} MB free, and {NEEDED_MB} MB are needed"
    done = subprocess.run(  # noqa: S603 - Python's own pip, no shell
        pip_install(folder, *OPTIONS, *options, "-r", str(lock)),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        check=False,
    )
    words = done.stdout.split("\n") if done.returncode else []
    return next((line.removeprefix("ERROR: ") for line in reversed(words) if line), "")


if __name__ == "__main__":
    # For the agent's user to read, whoever's shell this is.
    os.umask(0o022)
    sys.exit(install_video(Path(sys.prefix), sys.argv[1:]) or 0)
