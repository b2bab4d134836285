"""On what, with which versions and at which commit something was measured: all of it asked, none of it typed."""

from __future__ import annotations

import os
import platform
import re
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import docker
from demo import ROOT

if TYPE_CHECKING:
    from paper.world import World

# Service, what its daemon is called, and the command that tells its version.
DAEMONS = (
    ("nginx", "nginx", "nginx -v"),
    ("sshd", "OpenSSH", "ssh -V"),
    ("mysql", "MariaDB", "mariadbd --version"),
    ("relay", "Python of web and relay", "python3 --version"),
)
# Each part that ends writes them anew, which makes the sources no other ones.
OUR_OWN_PAGES = ":(exclude)docs/experiments"
_VERSION = re.compile(r"\d+\.\d[\w.]*")


def described() -> str:
    """What `git describe` calls the sources; raises OSError or CalledProcessError without git or its folder."""
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", OUR_OWN_PAGES)
    return _git("describe", "--always") + ("-dirty" if changed else "")


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def commit() -> str:
    """What `git describe` calls the sources; `unknown` without git or its folder."""
    try:
        return described()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def machine() -> dict[str, Any]:
    """Processor, cores, memory (GB) and kernel of this machine."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    memory_bytes = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return {
        "processor": models[0] if models else platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "memory_gb": round(memory_bytes / 1e9, 1),
        "kernel": platform.release().split("-")[0],
    }


def version_in(text: str) -> str:
    """The first version number of what a daemon says of itself; all of it when there is none."""
    found = _VERSION.search(text)
    return found[0] if found else " ".join(text.split())


def versions(world: World) -> Mapping[str, str]:
    """What runs: the stack's daemons, and on this machine Docker, OpenSSH's client and Python."""
    # Most daemons tell their versions on stderr.
    of_stack = {
        name: world.exec(service, "sh", "-c", f"{ask} 2>&1") for service, name, ask in DAEMONS
    }
    client = subprocess.run(["ssh", "-V"], capture_output=True, text=True, check=True).stderr
    return {
        **{name: version_in(text) for name, text in of_stack.items()},
        "OpenSSH of the robots": version_in(client),
        "Python of robots and experiments": platform.python_version(),
        "Docker": str(docker.from_env().version()["Version"]),
    }
