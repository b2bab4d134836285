"""A way without a tunnel over a real link: all that is measured, on the one way that every machine has."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest
from link import why_not_here
from paper.networks import uplinks
from paper.peers.measures import RATE_HZ, connect_s, per_mb, recover_s, round_trips, throughput
from paper.peers.transports import LINK, Straight, Transport

needs_root = pytest.mark.skipif(bool(why_not_here()), reason=why_not_here() or "-")
# Nobody is asked there.
NO_MACHINE = "192.0.2.9"


@pytest.fixture(scope="module")
def straight() -> Iterator[Transport]:
    with uplinks([LINK], NO_MACHINE) as [uplink], Straight(uplink) as transport:
        yield transport


@needs_root
def test_round_trips_are_those_of_the_link(straight: Transport) -> None:
    trips = asyncio.run(round_trips(straight, seconds=1.0))
    assert len(trips) == RATE_HZ
    assert min(trips) >= LINK.ping_ms


@needs_root
def test_a_load_fills_the_link_and_no_more(straight: Transport) -> None:
    got = asyncio.run(throughput(straight, seconds=2.0, settle_s=1.0))
    assert LINK.up_mbit_s is not None
    assert 0.5 < got["payload_bit_s"] / 1e6 / LINK.up_mbit_s < 1.1
    assert got["robot_cpu_s_per_mb"] == got["server_cpu_s_per_mb"] == 0


@needs_root
def test_a_message_passes_again_after_a_new_address(straight: Transport) -> None:
    assert asyncio.run(connect_s(straight)) is not None
    before = straight.inside.address
    took_s = asyncio.run(recover_s(straight, after_s=0.3))
    assert straight.inside.address != before
    assert took_s is not None
    assert took_s > LINK.ping_ms / 1000


def test_costs_are_told_for_each_megabyte() -> None:
    costs = per_mb((1.0, 1.0), (1.5, 3.0), 5_000_000)
    assert costs == {
        "robot_cpu_s_per_mb": pytest.approx(0.1),
        "server_cpu_s_per_mb": pytest.approx(0.4),
    }
