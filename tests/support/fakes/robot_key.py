"""A robot's key in a test's hands: joins the running stack, and runs OpenSSH's client as a robot or a thief would."""

from __future__ import annotations

import json
import select
import subprocess
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from commands import output_of_command, run_command
from openssh_server import make_key
from robotether_common.join import JOIN_NAMESPACE, join_message
from stack import Stack

# More than a server on a busy machine takes for a log-in.
ANSWER_S = 30
AT_ONCE = 4


class RobotKey:
    def __init__(self, stack: Stack, folder: Path, name: str) -> None:
        self.stack = stack
        self.name = name
        self.file = folder / name
        self._known_hosts = folder / "known_hosts"
        # The public key as one line.
        self.public = make_key(self.file, comment=name)

    @property
    def fingerprint(self) -> str:
        return output_of_command("ssh-keygen", "-lf", self.file).split()[1]

    def join(self, mac: str, **fields: object) -> tuple[int, dict[str, object]]:
        words = ["ssh-keygen", "-q", "-Y", "sign", "-n", JOIN_NAMESPACE, "-f", str(self.file)]
        token = str(fields["token"]) if "token" in fields else None
        message = join_message(token, mac, " ".join(self.public.split()[:2]))
        signature = output_of_command(*words, input=message)
        proof = {"mac": mac, "public_key": self.public, "signature": signature}
        body = {**proof, "hostname": self.name, "agent_version": "0.1.0", **fields}
        return self.stack.request("POST", "/api/v1/join", body)

    def ports(self) -> tuple[int, int]:
        [[ros, video]] = self.stack.sql(
            f"SELECT ros_port, video_port FROM robots WHERE name = '{self.name}'"
        )
        return int(ros), int(video)

    def command(self, *arguments: str, port: int | None = None) -> list[str]:
        options = [
            "BatchMode=yes",
            "IdentitiesOnly=yes",
            "StrictHostKeyChecking=accept-new",
            f"UserKnownHostsFile={self._known_hosts}",
            f"ConnectTimeout={ANSWER_S}",
            "ExitOnForwardFailure=yes",
        ]
        return [
            "ssh",
            "-F",
            "none",
            "-i",
            str(self.file),
            "-p",
            str(port or self.stack.ssh_port),
            *(part for option in options for part in ("-o", option)),
            *arguments,
        ]

    def ssh(
        self, *arguments: str, port: int | None = None, timeout: float = 2 * ANSWER_S
    ) -> subprocess.CompletedProcess[str]:
        return run_command(*self.command(*arguments, port=port), limit_s=timeout)

    def ssh_each(
        self, attempts: Iterable[tuple[str, ...]]
    ) -> Iterator[subprocess.CompletedProcess[str]]:
        with ThreadPoolExecutor(AT_ONCE) as pool:
            yield from pool.map(lambda arguments: self.ssh(*arguments), attempts)

    def start(self, *arguments: str, port: int | None = None) -> subprocess.Popen[str]:
        return subprocess.Popen(
            self.command(*arguments, port=port),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )


def first_line(running: subprocess.Popen[str]) -> str:
    """The first line that the client prints; fails with its error when none comes."""
    assert running.stdout is not None
    ready, _, _ = select.select([running.stdout], [], [], ANSWER_S)
    line = running.stdout.readline() if ready else ""
    if not line:
        running.kill()
        raise AssertionError(f"no line in {ANSWER_S} s: {running.communicate()[1]}")
    return line


def session_line(running: subprocess.Popen[str]) -> dict[str, object]:
    """The first line that the relay sends on a session, which proves the whole way."""
    return dict(json.loads(first_line(running)))
