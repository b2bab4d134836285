"""Installs the agent into a folder: `python3 -m robotether_agent.install FOLDER WHEEL REQUIREMENTS [OPTION OF PIP...]`.

join.sh and the playbooks run it with the robot's Python, before anything is installed, with the wheel itself as
PYTHONPATH. The folder becomes a virtual environment without pip: copying one there takes longer than all the rest.
In its place the wheel of pip runs that Python keeps for new environments. What encodes video comes after the rest, by
`install_video`.
"""

from __future__ import annotations

import ensurepip
import hashlib
import os
import subprocess
import sys
import sysconfig
import venv
from collections.abc import Sequence
from pathlib import Path

QUIET = ("--quiet", "--no-input", "--disable-pip-version-check")
# A robot has no compiler.
LOCKED = ("--require-hashes", "--only-binary", ":all:")


def find_pip() -> Path:
    """Return the wheel of pip that ensurepip would install."""
    # Debian, Ubuntu and Fedora keep it in a folder of their own.
    bundled = Path(ensurepip.__file__).with_name("_bundled")
    folder = Path(sysconfig.get_config_var("WHEEL_PKG_DIR") or bundled)
    files = sorted(folder.glob("pip-*.whl"))
    if not files:
        sys.exit(f"cannot find pip: {folder} has no wheel of it. Install python3-venv")
    return files[-1]


def pip_install(folder: Path, *words: str) -> tuple[str, ...]:
    """Return the command that installs locked packages into a virtual environment."""
    # Isolated (-I), so that what ROS has on PYTHONPATH does not count as installed. pip installs a package after those
    # that it needs: an agent that starts has them all, even after a power cut.
    python = (str(folder / "bin" / "python3"), "-I")
    return (*python, f"{find_pip()}/pip", "install", *QUIET, *LOCKED, *words)


def install(folder: Path, package: Path, requirements: Path, options: Sequence[str]) -> int:
    """Create the environment, fill it in one run of pip, and return pip's exit code."""
    venv.create(folder, symlinks=True)
    # pip wants a hash of each package; the installer has checked this one's already.
    sha256 = hashlib.sha256(package.read_bytes()).hexdigest()
    packages = ("-r", str(requirements), f"{package.resolve().as_uri()}#sha256={sha256}")
    command = pip_install(folder, *options, *packages)
    done = subprocess.run(  # noqa: S603 - Python's own pip, no shell
        command, stdin=subprocess.DEVNULL, check=False
    )
    # pip syncs nothing: a power cut shortly after the switch to this version would leave empty files in it.
    os.sync()
    return done.returncode


if __name__ == "__main__":
    folder, package, requirements = (Path(word) for word in sys.argv[1:4])
    sys.exit(install(folder, package, requirements, sys.argv[4:]))
