"""Robots behind a bare `ssh -R` as in the paper: one connection each for rosbridge and video, nothing of ours between.

An sshd of its own on this machine ends the connections and listens for operators on all addresses, as the paper's
server does with GatewayPorts. Used by the operators' experiment.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from local_network import free_port
from openssh_server import OpenSshServer, listens, wait_until

from paper.robots import ROSBRIDGE_PORT, VIDEO_PORT, WholeRobot

OPTIONS = (
    "BatchMode=yes",
    "StrictHostKeyChecking=no",
    "UserKnownHostsFile=/dev/null",
    "LogLevel=ERROR",
    "ExitOnForwardFailure=yes",
)


@dataclass(frozen=True)
class BarePorts:
    """Where one robot's services are on this machine."""

    ros: int
    video: int


@contextmanager
def bare_tunnels(robots: Sequence[WholeRobot]) -> Iterator[list[BarePorts]]:
    """Connect each robot from its own network to this machine, besides what its agent has."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="rt-bare-")))
        clients = stack.enter_context(ExitStack())
        # No session is opened, so that the relay behind sshd's session command is never asked.
        sshd = OpenSshServer(relay_port=0, address="0.0.0.0")
        # It ends before its clients: what a robot's kernel holds of its video is then dropped, not sent for seconds.
        stack.callback(sshd.close)
        sshd.start()
        ports = [BarePorts(free_port(), free_port()) for _ in robots]
        for robot, own in zip(robots, ports, strict=True):
            key = _authorized_key(sshd, folder / robot.name, own)
            words = _ssh(key, sshd, robot, own)
            command = robot.uplink.inside.command(*words)
            clients.enter_context(_running(command, folder / f"{robot.name}.log"))
        for port in (port for own in ports for port in (own.ros, own.video)):
            wait_until(
                lambda port=port: listens(port),
                lambda: f"the bare forward stands; {_logs(folder)}\nsshd: {sshd.log_text()}",
            )
        yield ports


def _authorized_key(sshd: OpenSshServer, key: Path, ports: BarePorts) -> Path:
    subprocess.run(
        ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(key)],
        check=True,
        stdin=subprocess.DEVNULL,
    )
    public = key.with_suffix(".pub").read_text().strip()
    sshd.authorize_too(public, (ports.ros, ports.video), ports.ros)
    return key


def _ssh(key: Path, sshd: OpenSshServer, robot: WholeRobot, ports: BarePorts) -> list[str]:
    options = [word for option in OPTIONS for word in ("-o", option)]
    forwards = [(ports.ros, ROSBRIDGE_PORT), (ports.video, VIDEO_PORT)]
    words = [f"0.0.0.0:{there}:{robot.address}:{here}" for there, here in forwards]
    transports = [word for forward in words for word in ("-R", forward)]
    login = f"{sshd.user}@{robot.uplink.machine}"
    return [
        "ssh",
        "-F",
        "none",
        "-N",
        "-i",
        str(key),
        "-p",
        str(sshd.port),
        *options,
        *transports,
        login,
    ]


@contextmanager
def _running(command: list[str], log: Path) -> Iterator[None]:
    # Its last word, that the server has gone, is for nobody.
    with (
        log.open("wb") as words,
        subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=words) as process,
    ):
        try:
            yield
        finally:
            process.terminate()


def _logs(folder: Path) -> str:
    return "\n".join(log.read_text(errors="replace") for log in sorted(folder.glob("*.log")))
