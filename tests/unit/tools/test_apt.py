"""How the tools install packages, with the real apt in a folder of its own."""

from __future__ import annotations

import fcntl
import os
import subprocess
from pathlib import Path
from threading import Timer

ROOT = Path(__file__).resolve().parents[3]
# Where the tests' user is not root.
SUDO = """#!/bin/sh
exec "$@"
"""


def test_apt_waits_for_another_one(tmp_path: Path) -> None:
    """A new machine installs updates in its first minutes, which holds the lock of dpkg."""
    (tmp_path / "sudo").write_text(SUDO)
    (tmp_path / "sudo").chmod(0o755)
    dpkg = tmp_path / "var" / "lib" / "dpkg"
    for folder in (dpkg, tmp_path / "var/cache/apt/archives/partial"):
        folder.mkdir(parents=True)
    (tmp_path / "var/lib/apt/lists/partial").mkdir(parents=True)
    (dpkg / "status").write_text("")
    (tmp_path / "apt.conf").write_text(f'Dir "{tmp_path}";\nDir::State::status "{dpkg}/status";\n')
    environ = {
        **os.environ,
        "PATH": f"{tmp_path}:{os.environ['PATH']}",
        "APT_CONFIG": str(tmp_path / "apt.conf"),
    }
    with (dpkg / "lock-frontend").open("w") as held:
        fcntl.lockf(held, fcntl.LOCK_EX)
        release = Timer(0.5, fcntl.lockf, (held, fcntl.LOCK_UN))
        release.start()
        done = subprocess.run(
            ["bash", "-c", ". tools/common.sh && apt_get install -y"],
            cwd=ROOT, env=environ, check=False, capture_output=True, text=True, timeout=30,
        )  # fmt: skip
        release.join()
    assert done.returncode == 0, done.stderr
