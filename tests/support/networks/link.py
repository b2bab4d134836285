"""An emulated network link between two namespaces, for experiments; needs root and /dev/net/tun.

    with Link(up=UP, down=DOWN) as link:
        link.robot.run("ping", "-c1", link.server.address)

`up` is from the namespace `robot` to `server`. Each has a TUN device; a process of its own (link_worker.py) carries the
packets between them, so that neither the experiment's own work nor its end disturbs the link or leaves it behind. Where
the kernel has netem it could do the same; this one has none, and one way that is the same on every machine is worth
more. The queue is in front of the rate, the delay behind it.
Known limits: some 10,000 packets a second each way, 0.2 ms more than the delay says, IPv4 alone.
"""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path

import namespaces
from link_queue import Shape
from namespaces import Namespace, ip

WORKER = Path(__file__).with_name("link_worker.py")
DEVICE = "link0"
ROBOT_ADDRESS, SERVER_ADDRESS, PREFIX_LENGTH = "10.77.0.1", "10.77.0.2", 30
WAIT_S = 30.0


def why_not_here() -> str:
    """Say what this machine lacks for a link, or nothing."""
    if os.geteuid() != 0:
        return "an emulated link needs root"
    return "" if Path("/dev/net/tun").exists() else "an emulated link needs /dev/net/tun"


class Link:
    """A running link; its namespaces are there inside `with` only."""

    def __init__(self, *, up: Shape, down: Shape) -> None:
        self.robot: Namespace
        self.server: Namespace
        self._shapes = [json.dumps(asdict(shape)) for shape in (up, down)]
        self._made = ExitStack()

    def __enter__(self) -> Link:
        namespaces.sweep()
        with ExitStack() as made:
            self.robot = namespaces.make(made, "robot", ROBOT_ADDRESS)
            self.server = namespaces.make(made, "server", SERVER_ADDRESS)
            self._start_worker(made)
            for end in (self.robot, self.server):
                self._give_address(end)
            self._made = made.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._made.close()

    def _start_worker(self, made: ExitStack) -> None:
        worker = subprocess.Popen(
            [
                *(sys.executable, "-E", "-s", str(WORKER)),
                *(self.robot.name, self.server.name, *self._shapes),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # A Ctrl-C is for the experiment, which then ends the link in order.
            start_new_session=True,
        )
        made.callback(_end, worker)
        assert worker.stdout is not None
        with selectors.DefaultSelector() as selector:
            selector.register(worker.stdout, selectors.EVENT_READ)
            if not selector.select(WAIT_S):
                raise RuntimeError(f"the link's worker did not answer in {WAIT_S:g} s")
        if worker.stdout.readline() != b"ready\n":
            raise RuntimeError("cannot start the link: its worker ended; see its words above")

    def _give_address(self, end: Namespace) -> None:
        here = ("-n", end.name)
        ip(*here, "link", "set", DEVICE, "addrgenmode", "none")
        ip(*here, "address", "add", f"{end.address}/{PREFIX_LENGTH}", "dev", DEVICE)
        ip(*here, "link", "set", DEVICE, "up")


def _end(worker: subprocess.Popen[bytes]) -> None:
    try:
        worker.communicate(timeout=WAIT_S)
    except subprocess.TimeoutExpired:
        worker.kill()
        worker.communicate()
