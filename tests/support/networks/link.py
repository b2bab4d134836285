"""An emulated network link between two namespaces, for tests and experiments; needs root and /dev/net/tun.

    with Link(up=Shape(rate_bit_s=5e6, delay_s=0.019), down=Shape(delay_s=0.019)) as link:
        link.robot.run("ping", "-c1", link.server.address)
        link.change(up=Shape(blackhole=True))

`up` is from the namespace `robot` to `server`. Each has a TUN device; a process of its own (link_worker.py) carries the
packets between them, so that neither the test's own work nor its end disturbs the link or leaves it behind. Where the
kernel has netem it could do the same; this one has none, and one way that is the same on every machine is worth more.
The queue is in front of the rate, the delay behind it. Order is kept, also with jitter.
Known limits: some 10,000 packets a second each way, 0.2 ms more than the delay says, IPv4 alone.
"""

from __future__ import annotations

import itertools
import json
import os
import selectors
import subprocess
import sys
from pathlib import Path
from types import TracebackType

import namespaces
from link_queue import Counts, Shape
from namespaces import Namespace, ip

__all__ = ["Counts", "Link", "Namespace", "Shape", "why_not_here"]

WORKER = Path(__file__).with_name("link_worker.py")
DEVICE = "link0"
ROBOT_ADDRESS, SERVER_ADDRESS, PREFIX_LENGTH = "10.77.0.1", "10.77.0.2", 30
WAIT_S = 30.0
_numbers = itertools.count(1)


def why_not_here() -> str:
    """Say what this machine lacks for a link, or nothing."""
    if os.geteuid() != 0:
        return "an emulated link needs root"
    return "" if Path("/dev/net/tun").exists() else "an emulated link needs /dev/net/tun"


class Link:
    """A running link; its namespaces are there inside `with` only."""

    def __init__(
        self,
        *,
        up: Shape,
        down: Shape,
        seed: int = 1,
        robot_address: str = ROBOT_ADDRESS,
        server_address: str = SERVER_ADDRESS,
        prefix_length: int = PREFIX_LENGTH,
    ) -> None:
        """Other addresses are for links that meet others behind their ends; both must be in one network."""
        name = f"{namespaces.PREFIX}-{os.getpid()}-{next(_numbers)}"
        self.robot = Namespace(f"{name}-robot", robot_address)
        self.server = Namespace(f"{name}-server", server_address)
        self._prefix_length = prefix_length
        self._shapes = {"up": up, "down": down}
        self._seed = seed
        self._worker: subprocess.Popen[str] | None = None

    def __enter__(self) -> Link:
        """Make the namespaces and join them."""
        namespaces.sweep()
        try:
            for end in (self.robot, self.server):
                namespaces.make(end)
            self._start_worker()
            for end in (self.robot, self.server):
                self._give_address(end)
            self.change(**self._shapes)
        except BaseException:
            self._clean_up()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Remove everything."""
        self._clean_up()

    def change(self, *, up: Shape | None = None, down: Shape | None = None) -> None:
        """Be another link from now on; what is not named stays as it is."""
        self._shapes.update(
            {name: shape for name, shape in (("up", up), ("down", down)) if shape is not None}
        )
        self._order({name: shape.as_dict() for name, shape in self._shapes.items()})

    def counts(self) -> tuple[Counts, Counts]:
        """What became of the packets so far: up, down."""
        answer = self._order({})
        return Counts(**answer["up"]), Counts(**answer["down"])

    def _start_worker(self) -> None:
        ends = [self.robot.name, self.server.name, str(self._seed)]
        self._worker = subprocess.Popen(
            [sys.executable, "-E", "-s", str(WORKER), *ends],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
            # A Ctrl-C is for the test, which then ends the link in order.
            start_new_session=True,
        )
        if self._line() != "ready\n":
            raise RuntimeError("cannot start the link: its worker ended; see its words above")

    def _give_address(self, end: Namespace) -> None:
        here = ("-n", end.name)
        ip(*here, "link", "set", DEVICE, "addrgenmode", "none")
        ip(*here, "address", "add", f"{end.address}/{self._prefix_length}", "dev", DEVICE)
        ip(*here, "link", "set", DEVICE, "up")

    def _order(self, order: dict[str, object]) -> dict[str, dict[str, int]]:
        assert self._worker is not None
        assert self._worker.stdin is not None
        self._worker.stdin.write(json.dumps(order) + "\n")
        self._worker.stdin.flush()
        answer: dict[str, dict[str, int]] = json.loads(self._line())
        return answer

    def _line(self) -> str:
        assert self._worker is not None
        assert self._worker.stdout is not None
        with selectors.DefaultSelector() as selector:
            selector.register(self._worker.stdout, selectors.EVENT_READ)
            if not selector.select(WAIT_S):
                raise RuntimeError(f"the link's worker did not answer in {WAIT_S:g} s")
        return self._worker.stdout.readline()

    def _clean_up(self) -> None:
        if self._worker is not None:
            self._end_worker(self._worker)
        for end in (self.robot, self.server):
            namespaces.remove(end.name)

    def _end_worker(self, worker: subprocess.Popen[str]) -> None:
        try:
            worker.communicate(timeout=WAIT_S)
        except subprocess.TimeoutExpired:
            worker.kill()
            worker.communicate()
