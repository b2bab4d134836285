"""The process between the two ends of an emulated link: moves packets from TUN to TUN as `link_queue` says.

Started by link.py with the names of two namespaces and the shapes of both ways as JSON. At the end of stdin, which
comes also when its owner is killed, it removes both namespaces and ends.
"""

from __future__ import annotations

import fcntl
import json
import os
import select
import struct
import sys
import time
from contextlib import suppress

import namespaces
from link_queue import Direction, Shape

TUNSETIFF = 0x400454CA
IFF_TUN, IFF_NO_PI = 0x0001, 0x1000
DEVICE = "link0"
PACKET_LIMIT = 65536
# How much too late a wait ends on a machine that is awake: it is asked to end before, and the rest is waited in a loop.
EARLY_S = 0.00006
# What a processor may take to wake, in microseconds, for as long as who wrote it keeps the file open.
NO_SLEEP = "/dev/cpu_dma_latency"
# Packets that are read in one go, so that a flood does not keep what is due from leaving.
BATCH = 32


def open_tun(namespace: str) -> int:
    """Make the device in `namespace` and return its descriptor, which works from anywhere."""
    namespaces.enter(namespace)
    descriptor = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(descriptor, TUNSETIFF, struct.pack("16sH22x", DEVICE.encode(), IFF_TUN | IFF_NO_PI))
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
    """Both directions, and where each begins and ends."""

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
    """Read what came, each packet with the moment of its reading."""
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
    robot, server, *shapes = sys.argv[1:]
    up, down = (Shape(**json.loads(shape)) for shape in shapes)
    try:
        worker = Worker(open_tun(robot), open_tun(server), up, down)
        be_punctual()
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        worker.run()
    finally:
        for name in (robot, server):
            namespaces.remove(name)


if __name__ == "__main__":
    main()
