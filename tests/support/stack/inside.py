"""Commands inside containers, by the engine's own command line.

Not by Docker's SDK for Python: its `exec_run` reads beside the buffer into which the answer's headers were read, so
that output that came with them is lost, as it does on a busy machine (docker-py's issue 3332).
"""

from __future__ import annotations

import subprocess
from collections.abc import Mapping

from docker.models.containers import Container

LIMIT_S = 60.0


def run_inside(
    container: Container,
    *command: str,
    user: str = "",
    environment: Mapping[str, str] | None = None,
    stdin: str = "",
    merged: bool = False,
    limit_s: float = LIMIT_S,
) -> subprocess.CompletedProcess[str]:
    """Run a command and return its exit code and what it printed, if `merged` all of it as `stdout`.

    Raises TimeoutExpired after `limit_s`.
    """
    options = ["--user", user] if user else []
    for name, value in (environment or {}).items():
        options += ["--env", f"{name}={value}"]
    return subprocess.run(
        ["docker", "exec", "--interactive", *options, str(container.id), *command],
        input=stdin,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT if merged else subprocess.PIPE,
        text=True,
        errors="replace",
        timeout=limit_s,
        check=False,
    )


def output_of(service: str, container: Container, *command: str, user: str = "") -> str:
    done = run_inside(container, *command, user=user)
    if done.returncode != 0:
        raise AssertionError(
            f"{' '.join(command)} in {service} exited {done.returncode}\n"
            f"{done.stdout[-4000:]}\n{done.stderr[-8000:]}"
        )
    return done.stdout
