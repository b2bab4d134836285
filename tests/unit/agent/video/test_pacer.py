"""How streams share what may be under way, and what the kernel tells of a connection."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Iterator

import pytest
from fake_cloud import eventually
from openssh_server import wait_until
from robotether_agent.video.bandwidth_estimator import Reading
from robotether_agent.video.pacer import (
    MAX_TURN_BYTES,
    SAVED_S,
    STUCK_AFTER_S,
    Pacer,
    TokenBucket,
    read,
)

SEGMENT = 1448
FIRST_WINDOW = 10 * SEGMENT
# Shorter than any test lets bytes be under way.
RTT_S = 0.001


def at(at_s: float, written: int) -> Reading:
    return Reading(at_s, written, 0, 0.04, 0.04, 1448)


def test_a_bucket_keeps_little_that_nobody_wanted() -> None:
    """A frame after a pause is no burst of all that could have gone meanwhile."""
    bucket = TokenBucket(5.0, 0)
    assert bucket.fill(9.0, 100_000, has_waited=False, least=0) == int(100_000 * SAVED_S)
    assert bucket.fill(99.0, 100, has_waited=False, least=2048) == 2048


class Connection:
    """A media connection whose ssh writes what it is handed, and whose path delivers when it is told to."""

    def __init__(self) -> None:
        self.written = 5000
        self.arrived = 5000
        self.known = True
        self.looks = 0

    def read_state(self, _: socket.socket, now_s: float) -> Reading | None:
        self.looks += 1
        if not self.known:
            return None
        return Reading(now_s, self.written, self.arrived, RTT_S, RTT_S, SEGMENT)


@pytest.fixture
def connection() -> Connection:
    return Connection()


@pytest.fixture
def pacer(connection: Connection) -> Iterator[Pacer]:
    made = Pacer(connection.read_state)
    with socket.socket() as handle:
        made._connection = handle
        yield made
        made.hold()


class Taker:
    def __init__(
        self, pacer: Pacer, connection: Connection | None = None, *, is_bulk: bool = False
    ) -> None:
        self.got = 0
        self._is_bulk = is_bulk
        self._pacer = pacer
        self._connection = connection
        self.task = asyncio.ensure_future(self._run())

    async def _run(self) -> None:
        while True:
            granted = await self._pacer.acquire(MAX_TURN_BYTES, is_bulk=self._is_bulk)
            self.got += granted
            if self._connection is not None:
                self._connection.written += granted
            await asyncio.sleep(0)

    async def end(self) -> None:
        self.task.cancel()
        await asyncio.gather(self.task, return_exceptions=True)


async def test_no_more_than_the_window_gets_in_flight(pacer: Pacer, connection: Connection) -> None:
    taker = Taker(pacer, connection)
    await eventually(lambda: taker.got >= FIRST_WINDOW - 2048, lambda: f"got {taker.got}")
    await asyncio.sleep(0.02)
    assert taker.got <= FIRST_WINDOW
    connection.arrived = connection.written
    await eventually(lambda: taker.got > FIRST_WINDOW, lambda: f"got {taker.got}")
    await taker.end()


async def test_what_ssh_still_has_counts(pacer: Pacer, connection: Connection) -> None:
    """Between the hand-over and ssh's write nobody gets the same room again."""
    first = await pacer.acquire(MAX_TURN_BYTES)
    assert first == FIRST_WINDOW
    waits = asyncio.ensure_future(pacer.acquire(MAX_TURN_BYTES))
    await asyncio.sleep(0.02)
    assert not waits.done()
    connection.written += first
    connection.arrived += first
    assert await waits > 0


async def test_a_viewer_that_takes_nothing_does_not_hold_up_the_others(pacer, connection):
    assert await pacer.acquire(MAX_TURN_BYTES) == FIRST_WINDOW
    assert await asyncio.wait_for(pacer.acquire(MAX_TURN_BYTES), STUCK_AFTER_S * 8) > 0


async def _looks_in(connection: Connection, lasts_s: float) -> int:
    before = connection.looks
    await asyncio.sleep(lasts_s)
    return connection.looks - before


async def test_a_frame_is_followed_until_it_has_arrived(pacer, connection):
    connection.written += await pacer.acquire(MAX_TURN_BYTES)
    before = connection.looks
    await eventually(lambda: connection.looks > before + 5, lambda: "it is not looked at")
    connection.arrived = connection.written
    await asyncio.sleep(0.05)
    assert await _looks_in(connection, 0.1) == 0


async def test_streams_share_fairly(pacer: Pacer, connection: Connection) -> None:
    takers = [Taker(pacer, connection) for _ in range(3)]

    def all_got(amount: int) -> bool:
        connection.arrived = min(connection.written, connection.arrived + 20_000)
        return sum(taker.got for taker in takers) > amount

    await eventually(lambda: all_got(300_000), lambda: f"got {[t.got for t in takers]}")
    for taker in takers:
        await taker.end()
    got = [taker.got for taker in takers]
    assert max(got) - min(got) <= 3 * MAX_TURN_BYTES


async def test_bulk_leaves_others_three_turns_in_four(pacer: Pacer, connection: Connection) -> None:
    """However many wait with it; and it gets all that nobody else wants."""
    bulk = [Taker(pacer, connection, is_bulk=True) for _ in range(10)]
    video = Taker(pacer, connection)

    def sent() -> int:
        connection.arrived = min(connection.written, connection.arrived + 20_000)
        return video.got + sum(taker.got for taker in bulk)

    await eventually(lambda: sent() > 600_000, lambda: f"video {video.got} of {sent()}")
    assert 0.6 < video.got / sent() < 0.9
    await video.end()
    before = sent()
    await eventually(lambda: sent() > before + 300_000, lambda: f"{sent() - before} of bulk")
    for taker in bulk:
        await taker.end()


async def test_one_who_leaves_while_it_waits_is_forgotten(pacer, connection):
    await pacer.acquire(MAX_TURN_BYTES)
    leaves = asyncio.ensure_future(pacer.acquire(MAX_TURN_BYTES))
    stays = asyncio.ensure_future(pacer.acquire(MAX_TURN_BYTES))
    await asyncio.sleep(0)
    leaves.cancel()
    connection.written += FIRST_WINDOW
    connection.arrived = connection.written
    assert await stays > 0
    assert leaves.cancelled()


async def test_without_a_connection_everybody_gets_all(caplog: pytest.LogCaptureFixture) -> None:
    pacer = Pacer()
    with caplog.at_level(logging.WARNING):
        assert [await pacer.acquire(100_000) for _ in range(3)] == [100_000] * 3
    assert len(caplog.records) == 1
    assert "passed on unpaced" in caplog.text


async def test_while_it_is_held_everybody_waits(pacer, connection, caplog):
    pacer.hold()
    waits = asyncio.ensure_future(pacer.acquire(MAX_TURN_BYTES))
    await asyncio.sleep(0.02)
    assert not waits.done()
    with socket.socket() as handle:
        pacer.use(handle)
        assert await waits == FIRST_WINDOW
    assert not caplog.records


def look(connection: socket.socket) -> Reading:
    reading = read(connection, 7.0)
    assert reading is not None
    return reading


def test_tells_what_was_written_and_what_arrived(pair: tuple[socket.socket, socket.socket]) -> None:
    here, _ = pair
    before = look(here)
    here.sendall(bytes(10_000))
    wait_until(lambda: look(here).in_flight == 0, lambda: "all has arrived")
    after = look(here)
    assert after.written - before.written == 10_000
    assert after.arrived - before.arrived == 10_000
    assert after.at_s == 7.0
    assert 0 < after.min_rtt_s <= after.rtt_s < 1
    assert 500 < after.segment < 70_000
