"""An emulated network link between two namespaces, for experiments; needs root and /dev/net/tun.

`up` is from the namespace `robot` to `server`. Each has a TUN device; a process of its own (`main`) carries the packets
between them, so that neither the experiment's own work nor its end disturbs the link or leaves it behind. Where
the kernel has netem it could do the same; this one has none, and one way that is the same on every machine is worth
more. The queue is in front of the rate, the delay behind it.
Known limits: some 10,000 packets a second each way, 0.2 ms more than the delay says, IPv4 alone.
"""

from __future__ import annotations

import fcntl
import json
import os
import select
import selectors
import struct
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import namespaces
from namespaces import Namespace, ip


@dataclass(frozen=True, kw_only=True)
class Shape:
    """What a direction does to packets; bytes are those of the IP packet."""

    rate_bit_s: float
    delay_s: float
    # What may wait for the link, the packet on the wire included; what finds it full is dropped.
    queue_bytes: int


class Direction:
    """The packets on the way in one direction; times are seconds of any clock that does not go back."""

    def __init__(self, shape: Shape) -> None:
        self._shape = shape
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        # When the link has sent the packet at the head of `_waiting`.
        self._sent_at = 0.0
        self._flying: deque[tuple[float, bytes]] = deque()

    def offer(self, now: float, packet: bytes) -> None:
        self._send(now)
        if self._waiting_bytes + len(packet) > self._shape.queue_bytes:
            return
        if not self._waiting:
            self._sent_at = now + self._duration_s(packet)
        self._waiting.append(packet)
        self._waiting_bytes += len(packet)

    def due(self, now: float) -> Iterator[bytes]:
        self._send(now)
        while self._flying and self._flying[0][0] <= now:
            yield self._flying.popleft()[1]

    def next_at(self) -> float | None:
        times = [self._flying[0][0]] if self._flying else []
        return min([*times, self._sent_at] if self._waiting else times, default=None)

    def _send(self, now: float) -> None:
        while self._waiting and self._sent_at <= now:
            packet = self._waiting.popleft()
            self._waiting_bytes -= len(packet)
            self._flying.append((self._sent_at + self._shape.delay_s, packet))
            if self._waiting:
                self._sent_at += self._duration_s(self._waiting[0])

    def _duration_s(self, packet: bytes) -> float:
        return len(packet) * 8 / self._shape.rate_bit_s


TUNSETIFF = 0x400454CA
IFF_TUN, IFF_NO_PI = 0x0001, 0x1000
DEVICE = "link{}"
PACKET_LIMIT = 65536
# How much too late a wait ends on a machine that is awake: it is asked to end before, and the rest is waited in a loop.
EARLY_S = 0.00006
# What a processor may take to wake, in microseconds, for as long as who wrote it keeps the file open.
NO_SLEEP = "/dev/cpu_dma_latency"
# Packets that are read in one go, so that a flood does not keep what is due from leaving.
BATCH = 32


def open_tun(namespace: str, device: str) -> int:
    namespaces.enter(namespace)
    descriptor = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(descriptor, TUNSETIFF, struct.pack("16sH22x", device.encode(), IFF_TUN | IFF_NO_PI))
    return descriptor


def be_punctual() -> None:
    """Run before what only computes, and let no processor sleep, where that is allowed; until this process ends.

    A packet late by a time slice is a wrong delay. And a virtual processor that has nothing to do takes some 0.2 ms to
    wake, six times on one way there and back: kept awake, it idles in a loop, as for cyclictest.
    """
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    with suppress(OSError):
        os.write(os.open(NO_SLEEP, os.O_WRONLY), struct.pack("i", 0))


class Worker:
    def __init__(self, robot: int, server: int, up: Shape, down: Shape) -> None:
        self._ways = ((Direction(up), robot, server), (Direction(down), server, robot))

    def run(self) -> None:
        waiting = [0, *(entry for _, entry, _ in self._ways)]
        while True:
            ready, _, _ = select.select(waiting, [], [], self._pause_s())
            for direction, entry, _ in self._ways:
                if entry in ready:
                    take(direction, entry)
            now = time.monotonic()
            for direction, _, way_out in self._ways:
                for packet in direction.due(now):
                    put(way_out, packet)
            if 0 in ready:
                return

    def _pause_s(self) -> float | None:
        times = [at for direction, _, _ in self._ways if (at := direction.next_at()) is not None]
        return max(0.0, min(times) - time.monotonic() - EARLY_S) if times else None


def take(direction: Direction, entry: int) -> None:
    for _ in range(BATCH):
        try:
            packet = os.read(entry, PACKET_LIMIT)
        except BlockingIOError:
            return
        direction.offer(time.monotonic(), packet)


def put(way_out: int, packet: bytes) -> None:
    """Deliver one packet; a device that was set down takes none, as a real one."""
    with suppress(OSError):
        os.write(way_out, packet)


def main() -> None:
    """Carry packets, given a device, the names of both namespaces and both ways' shapes as JSON, until the input ends.

    That comes also when the owner is killed; both namespaces are removed then.
    """
    device, robot, server, *shapes = sys.argv[1:]
    up, down = (Shape(**json.loads(shape)) for shape in shapes)
    try:
        worker = Worker(open_tun(robot, device), open_tun(server, device), up, down)
        be_punctual()
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        worker.run()
    finally:
        for name in (robot, server):
            namespaces.remove(name)


ROBOT_ADDRESS, SERVER_ADDRESS, PREFIX_LENGTH = "10.77.{}.1", "10.77.{}.2", 30
WAIT_S = 30.0


def why_not_here() -> str:
    """Say what this machine lacks for a link, or nothing."""
    if os.geteuid() != 0:
        return "an emulated link needs root"
    return "" if Path("/dev/net/tun").exists() else "an emulated link needs /dev/net/tun"


class Link:
    """A running link; its namespaces are there inside `with` only. One that is `beside` another has the same server."""

    def __init__(self, *, up: Shape, down: Shape, beside: Link | None = None) -> None:
        self.robot: Namespace
        self.server: Namespace
        self._beside = beside
        self._number: int = 0 if beside is None else beside._number + 1
        self._device = DEVICE.format(self._number)
        self._shapes = [json.dumps(asdict(shape)) for shape in (up, down)]
        self._made = ExitStack()

    def __enter__(self) -> Link:
        namespaces.sweep()
        robot, server = (each.format(self._number) for each in (ROBOT_ADDRESS, SERVER_ADDRESS))
        with ExitStack() as made:
            self.robot = namespaces.make(made, "robot", robot)
            if self._beside is None:
                self.server = namespaces.make(made, "server", server)
            else:
                self.server = Namespace(self._beside.server.name, server)
            self._start_worker(made)
            for end in (self.robot, self.server):
                self._give_address(end)
            # The server's other addresses.
            ip("-n", self.robot.name, "route", "add", "default", "via", server)
            self._made = made.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._made.close()

    def _start_worker(self, made: ExitStack) -> None:
        worker = subprocess.Popen(
            [
                *(sys.executable, "-E", "-s", __file__),
                *(self._device, self.robot.name, self.server.name, *self._shapes),
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
        ip(*here, "link", "set", self._device, "addrgenmode", "none")
        ip(*here, "address", "add", f"{end.address}/{PREFIX_LENGTH}", "dev", self._device)
        ip(*here, "link", "set", self._device, "up")


def _end(worker: subprocess.Popen[bytes]) -> None:
    try:
        worker.communicate(timeout=WAIT_S)
    except subprocess.TimeoutExpired:
        worker.kill()
        worker.communicate()


if __name__ == "__main__":
    main()
