"""The emulated link with real traffic: rate, round trip, queue, loss, order, changes, and what it leaves behind."""

from __future__ import annotations

import os
import socket
import statistics
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress

import pytest
from link import Link, Namespace, Shape, why_not_here

pytestmark = [
    pytest.mark.alone,
    pytest.mark.skipif(bool(why_not_here()), reason=why_not_here() or "-"),
]

PORT = 5000
# Not in the module socket.
SO_RCVBUFFORCE = 33
DATAGRAM = 1000
# Of the IP packet: payload, UDP, IP.
PACKET = DATAGRAM + 28


def udp(end: Namespace, port: int = 0) -> socket.socket:
    with end.entered():
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 1 << 22)
    made.bind((end.address, port))
    made.settimeout(2)
    return made


@contextmanager
def echoing(link: Link) -> Iterator[None]:
    """A UDP echo at the server's end."""
    with closing(udp(link.server, PORT)) as echo:

        def serve() -> None:
            try:
                while data := echo.recvfrom(2048):
                    if data[0] == b"end":
                        return
                    echo.sendto(*data)
            except TimeoutError:
                return

        thread = threading.Thread(target=serve)
        thread.start()
        yield
        with closing(udp(link.server)) as last:
            last.sendto(b"end", (link.server.address, PORT))
        thread.join()


@contextmanager
def punctual() -> Iterator[None]:
    """This thread, and those that it starts meanwhile, run before what only computes, as the link's worker does.

    Else what is measured is who else has the processor.
    """
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, parameters)


def round_trips_ms(link: Link, count: int = 40) -> list[float]:
    found = []
    with punctual(), echoing(link), closing(udp(link.robot)) as here:
        for _ in range(count):
            sent = time.perf_counter()
            here.sendto(b"x" * 172, (link.server.address, PORT))
            here.recv(2048)
            found.append((time.perf_counter() - sent) * 1000)
    return found


def received(there: socket.socket, until_s: float = 0.5) -> list[tuple[float, bytes]]:
    """All datagrams until none comes for `until_s`, each with its moment."""
    there.settimeout(until_s)
    found = []
    try:
        while True:
            data = there.recv(2048)
            found.append((time.perf_counter(), data))
    except TimeoutError:
        return found


def burst(link: Link, count: int) -> list[tuple[float, bytes]]:
    """Send `count` numbered datagrams at once from the robot, and return what arrived."""
    with closing(udp(link.server, PORT)) as there, closing(udp(link.robot)) as here:

        def send() -> None:
            for number in range(count):
                here.sendto(number.to_bytes(4, "big").ljust(DATAGRAM), (link.server.address, PORT))

        sender = threading.Thread(target=send)
        sender.start()
        found = received(there)
        sender.join()
        return found


def burst_rate(link: Link) -> float:
    """The rate in bit/s from the first to the last of 600 packets, none of which is lost."""
    arrived = burst(link, 600)
    assert len(arrived) == 600
    return 599 * PACKET * 8 / (arrived[-1][0] - arrived[0][0])


def bulk_rate(link: Link) -> float:
    """The rate in bit/s of 2 MB over a TCP connection from the robot."""
    with link.server.entered():
        listener = socket.create_server((link.server.address, PORT))
    with link.robot.entered():
        here = socket.create_connection((link.server.address, PORT), timeout=5)
    there, _ = listener.accept()
    with listener, here, there:
        sender = threading.Thread(target=here.sendall, args=(bytes(2_000_000),))
        sender.start()
        there.settimeout(5)
        total, started = 0, time.perf_counter()
        while total < 2_000_000:
            total += len(there.recv(65536))
        lasted_s = time.perf_counter() - started
        sender.join()
    return total * 8 / lasted_s


def test_round_trip_is_both_delays() -> None:
    """Within 1 ms at the median."""
    with Link(up=Shape(delay_s=0.019), down=Shape(delay_s=0.012)) as link:
        assert statistics.median(round_trips_ms(link)) == pytest.approx(31, abs=1)


@pytest.mark.parametrize("rate", [4.97e6, 50e6])
def test_rate_is_kept(rate: float) -> None:
    """Within 5 %, in the middle one of three bursts that wait in the queue: the machine may pause in one."""
    with Link(up=Shape(rate_bit_s=rate, queue_bytes=1 << 20), down=Shape()) as link:
        rates = [burst_rate(link) for _ in range(3)]
    assert statistics.median(rates) == pytest.approx(rate, rel=0.05), rates


def test_tcp_gets_through_at_the_rate() -> None:
    """Bulk transfers over both directions, as an SSH connection would make them; the machine may pause in one."""
    shape = Shape(rate_bit_s=10e6, delay_s=0.005)
    with Link(up=shape, down=shape) as link:
        rates = [bulk_rate(link) for _ in range(3)]
    # The headers of IP and TCP take 3.5 %, the start some more.
    assert 8.5e6 < statistics.median(rates) < 10e6, rates
