"""How to reach a host: what OpenSSH itself would do, asked with `ssh -G`.

So `Include`, `Match`, defaults and the order of files are OpenSSH's own, and what works with `ssh NAME` works here.
"""

import subprocess
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from robotether_server.cli.fleet.problems import ConfigUnusable

SSH_PORT = 22
CONNECT_TIMEOUT_S = 10.0
ANSWER_WITHIN_S = 10


@dataclass(frozen=True)
class Target:
    """One host to log in to. `known_as`: its name in the known_hosts files; `jump`: through which host."""

    name: str
    host: str
    port: int
    user: str
    known_as: str
    known_hosts: tuple[Path, ...]
    identity_files: tuple[Path, ...]
    identities_only: bool
    connect_timeout_s: float
    jump: "Target | None" = None


def resolve(name: str, config: Path | None) -> Target:
    """Return how to reach a robot; raise ConfigUnusable."""
    said = ask(name, config)
    jump = None
    for hop in said.get("proxyjump", ["none"])[0].split(","):
        if hop != "none":
            jump = _target(f"the jump host {hop}", ask(f"ssh://{hop}", config), jump)
    return _target(name, said, jump)


def ask(destination: str, config: Path | None) -> dict[str, list[str]]:
    """Return OpenSSH's settings for a destination: each keyword's values, one a line of `ssh -G`."""
    chosen = [] if config is None else ["-F", str(config)]
    # -T and no standard input: it only prints, and must neither ask nor speak of terminals.
    command = ["ssh", *chosen, "-T", "-G", "--", destination]
    try:
        done = subprocess.run(  # noqa: S603 - no shell, and the name stands behind `--`
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=ANSWER_WITHIN_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ConfigUnusable(
            f"cannot ask ssh how to reach {destination}: {error}; install OpenSSH's client"
        ) from error
    if done.returncode != 0:
        raise ConfigUnusable(f"cannot reach {destination}: ssh says: {done.stderr.strip()}")
    said: dict[str, list[str]] = defaultdict(list)
    for line in done.stdout.splitlines():
        keyword, _, value = line.partition(" ")
        said[keyword].append(value)
    return dict(said)


def _target(name: str, said: dict[str, list[str]], jump: Target | None) -> Target:
    def first(keyword: str, otherwise: str = "") -> str:
        return said.get(keyword, [otherwise])[0]

    if first("proxycommand", "none") != "none":
        raise ConfigUnusable(
            f"cannot reach {name}: its entry has a ProxyCommand; fleet speaks ProxyJump"
        )
    host, port = first("hostname"), int(first("port", str(SSH_PORT)))
    timeout = first("connecttimeout", "none")
    return Target(
        name=name,
        host=host,
        port=port,
        user=first("user"),
        known_as=first("hostkeyalias") or _address(host, port),
        known_hosts=_paths(first("userknownhostsfile"), first("globalknownhostsfile")),
        identity_files=_paths(*said.get("identityfile", [])),
        identities_only=first("identitiesonly") == "yes",
        connect_timeout_s=CONNECT_TIMEOUT_S if timeout == "none" else float(timeout),
        jump=jump,
    )


def _address(host: str, port: int) -> str:
    """Return a host's name as known_hosts files have it."""
    return host.lower() if port == SSH_PORT else f"[{host.lower()}]:{port}"


def _paths(*values: str) -> tuple[Path, ...]:
    words = [
        word for value in values for word in value.split() if word not in ("none", "/dev/null")
    ]
    return tuple(Path(word).expanduser() for word in words)
