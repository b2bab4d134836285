"""How the tools install packages, with the real apt in a folder of its own, while another one is at work there.

A new machine installs updates in its first minutes.
"""

from __future__ import annotations

import fcntl
import os
import subprocess
from pathlib import Path
from threading import Timer

ROOT = Path(__file__).resolve().parents[3]
PROGRAMS = {
    # Where the tests' user is not root.
    "sudo": '[ "$1" = -v ] || exec "$@"',
    "sleep": "exec /bin/sleep 0.2",
}


def run_beside(tmp_path: Path, lock: Path, command: str) -> subprocess.CompletedProcess[str]:
    """Run a line of the tools' shell; another process lets go of the lock half a second later."""
    for name, text in PROGRAMS.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{text}\n")
        (tmp_path / name).chmod(0o755)
    state = tmp_path / "var" / "lib"
    for folder in ("dpkg", "apt/lists/partial"):
        (state / folder).mkdir(parents=True)
    (tmp_path / "var/cache/apt/archives/partial").mkdir(parents=True)
    (tmp_path / "etc/apt").mkdir(parents=True)
    (state / "dpkg/status").write_text("")
    (tmp_path / "apt.conf").write_text(
        f'Dir "{tmp_path}";\nDir::State::status "{state}/dpkg/status";\n'
    )
    environ = {
        **os.environ,
        "PATH": f"{tmp_path}:{os.environ['PATH']}",
        "APT_CONFIG": str(tmp_path / "apt.conf"),
    }
    with (state / lock).open("w") as held:
        fcntl.lockf(held, fcntl.LOCK_EX)
        release = Timer(0.5, fcntl.lockf, (held, fcntl.LOCK_UN))
        release.start()
        done = subprocess.run(
            ["bash", "-euc", f". tools/common.sh; {command}"],
            cwd=ROOT, env=environ, check=False, capture_output=True, text=True, timeout=30,
        )  # fmt: skip
        release.join()
    return done


def test_packages_wait_for_another_apt(tmp_path: Path) -> None:
    """Apt itself waits for dpkg's lock."""
    done = run_beside(tmp_path, Path("dpkg/lock-frontend"), "apt_get install -y")
    assert done.returncode == 0, done.stderr


def test_lists_wait_for_another_apt(tmp_path: Path) -> None:
    """Apt fails at the lock of its lists."""
    done = run_beside(tmp_path, Path("apt/lists/lock"), "apt_update")
    assert done.returncode == 0, done.stderr
    assert "Could not get lock" in done.stderr
