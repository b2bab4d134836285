"""The pace of video: how a modelled path is filled, and how streams share what may be under way."""

import asyncio
import logging
import socket
import statistics
from collections import deque
from random import Random

import pytest
from fake_cloud import eventually
from hypothesis import given, settings
from hypothesis import strategies as st
from openssh_server import wait_until
from robotether_agent.video.bandwidth_estimator import (
    BASE_FOR_S,
    FULL_FOR_S,
    MAX_WINDOW,
    MIN_SEGMENTS,
    BandwidthEstimator,
    Reading,
)
from robotether_agent.video.pacer import (
    MAX_TURN_BYTES,
    SAVED_S,
    STUCK_AFTER_S,
    Pacer,
    TokenBucket,
    read,
)

LOOK_S = 0.004
SEGMENT = 1448
UPLINK = 4.97e6 / 8


class Path:
    """A link with one queue and a sender that keeps the estimator's window under way, looked at every 4 ms.

    Round trips differ by `jitter_s`. `others` is what others have in the same queue, in bytes; it neither grows nor
    shrinks by itself.
    """

    def __init__(self, rate, base_s):
        self.rate = rate
        self.base_s = base_s
        self.jitter_s = 0.0
        self._rng = Random(1)
        self.others = 0.0
        self.offers = lambda _now: True
        self.now = 0.0
        self.queues_s = []
        self._written = 10_000.0
        self._arrived = 10_000.0
        self._sent = 10_000.0
        self._acks = deque()
        self._rtt_s = base_s
        self._stalls_until = 0.0
        self.estimator = BandwidthEstimator(self._reading(base_s))

    def run(self, lasts_s):
        self.queues_s = []
        before, until = self._sent, self.now + lasts_s
        while self.now < until:
            self._step()
        return (self._sent - before) / (self.rate * lasts_s)

    def _step(self):
        self._carry()
        self._look()

    def _carry(self):
        self.now += LOOK_S
        own = self._written - self._sent
        share = own / (own + self.others) if own else 0.0
        self._sent += min(own, self.rate * LOOK_S * share)
        queue_s = (self._written - self._sent + self.others) / self.rate
        self.queues_s.append(queue_s)
        self._acks.append((self.now + self.base_s, self._sent))
        while self._acks and self._acks[0][0] <= self.now and self.now >= self._stalls_until:
            _, arrived = self._acks.popleft()
            if arrived > self._arrived:
                self._arrived = arrived
                # Some acknowledgements came in this step, and the kernel smooths by an eighth each.
                jitter_s = self._rng.uniform(-self.jitter_s, self.jitter_s)
                self._rtt_s += (self.base_s + queue_s + jitter_s - self._rtt_s) * 0.6

    def _look(self):
        is_offered = self.offers(self.now)
        self._send(is_offered, MAX_WINDOW if is_offered else 0.0)

    def _send(self, was_full, offered):
        reading = self._reading(self._rtt_s)
        self.estimator.update(reading, was_full=was_full, is_handed=not was_full)
        room = max(0.0, self.estimator.window - reading.in_flight)
        sent = min(room, self.estimator.speed * LOOK_S, offered)
        self._written += sent
        return sent

    def _reading(self, rtt_s):
        return Reading(
            self.now, int(self._written), int(self._arrived), rtt_s, self.base_s, SEGMENT
        )


class Camera(Path):
    """A path whose sender has `fps` frames a second, and drops the one that comes while the last still waits."""

    def __init__(self, rate, base_s, frame, fps=15):
        super().__init__(rate, base_s)
        self.took_s = []
        # The part of the frames of which a segment is lost, so that all behind it counts a round trip later.
        self.lost_part = 0.0
        self._frame = frame
        self._fps = fps
        self._waits = 0.0
        self._taken_at = self._next_at = 0.0
        self._arriving = deque()

    def _look(self):
        was_full = self._waits > 0
        if self.now >= self._next_at:
            self._next_at += 1 / self._fps
            if not was_full:
                self._waits, self._taken_at = self._frame, self.now
                if self._rng.random() < self.lost_part:
                    self._stalls_until = self.now + 2 * self.base_s
        sent = self._send(was_full, self._waits)
        self._waits -= sent
        if sent and not self._waits:
            self._arriving.append((self._taken_at, self._written))
        while self._arriving and self._arrived >= self._arriving[0][1] - 1:
            self.took_s.append(self.now - self._arriving.popleft()[0])


def p95(values):
    return statistics.quantiles(values, n=20)[-1]


@settings(max_examples=10)
@given(st.floats(0.5e6, 100e6), st.floats(0.005, 0.3))
def test_fills_any_link_that_holds_more_than_the_least(bit_s, base_s):
    """Alone it uses at least three quarters, and never has a longer queue than the minimum window's."""
    path = Path(bit_s / 8, base_s)
    path.run(12)
    used = path.run(8)
    least_s = MIN_SEGMENTS * SEGMENT / path.rate
    assert used > 0.75
    assert statistics.median(path.queues_s) < max(0.015, least_s)


def test_says_what_a_line_carries_only_while_it_is_full():
    path = Path(UPLINK, 0.038)
    path.run(5)
    assert path.estimator.full_rate(path.now) == pytest.approx(UPLINK, rel=0.2)
    path.offers = lambda _: False
    path.run(FULL_FOR_S + 1)
    assert path.estimator.full_rate(path.now) is None
    camera = Camera(10 * UPLINK, 0.038, frame=20_000)
    camera.run(10)
    assert camera.estimator.full_rate(camera.now) is None


def test_lets_a_link_that_becomes_slower_drain():
    path = Path(20e6 / 8, 0.04)
    path.run(5)
    path.rate = 2e6 / 8
    path.run(1)
    assert path.run(5) > 0.75
    assert p95(path.queues_s) < 0.03


def test_gives_way_to_others_and_never_starves():
    path = Path(UPLINK, 0.038)
    path.run(5)
    path.others = 100_000.0
    path.run(2)
    assert MIN_SEGMENTS * SEGMENT <= path.estimator.window < 6000
    path.run(10)
    assert MIN_SEGMENTS * SEGMENT <= path.estimator.window < 30_000
    path.others = 0.0
    path.run(2)
    assert path.run(5) > 0.9


def test_jitter_is_no_queue():
    path = Path(UPLINK, 0.06)
    path.base_s, path.jitter_s = 0.08, 0.02
    path.run(8)
    assert path.run(20) > 0.75


def test_notices_that_the_path_became_longer():
    path = Path(UPLINK, 0.038)
    path.run(5)
    path.base_s = 0.09
    path.run(BASE_FOR_S + 3)
    assert path.run(5) > 0.9
    assert statistics.median(path.queues_s) < 0.02


@pytest.mark.parametrize(
    ("bit_s", "base_s", "frame"),
    [
        (89e6, 0.007, 36_000.0),
        (5e6, 0.038, 24_000.0),
        (9e6, 0.019, 12_000.0),
        (19e6, 0.015, 36_000.0),
        (5.4e6, 0.031, 12_000.0),
    ],
)
def test_a_frame_that_fits_is_not_held_up(bit_s, base_s, frame):
    path = Camera(bit_s / 8, base_s, frame)
    path.run(5)
    path.took_s.clear()
    path.run(15)
    assert len(path.took_s) > 14.5 * 15
    assert statistics.median(path.took_s) < frame / path.rate + base_s + 3 * LOOK_S
    assert p95(path.queues_s) < 0.025


def test_frames_with_pauses_are_not_held_up_to_measure_the_path():
    """The pauses empty the queue by themselves, even if no round trip is ever again as short as the shortest."""
    path = Camera(5e6 / 8, 0.038, 33_000.0)
    path.run(5)
    path.base_s += 0.005
    path.took_s.clear()
    path.run(3 * BASE_FOR_S)
    assert max(path.took_s) < statistics.median(path.took_s) + 0.03


def test_losses_make_no_path_narrow():
    path = Camera(89e6 / 8, 0.2, 24_000.0, fps=2)
    path.run(10)
    path.lost_part = 0.8
    path.run(20)
    path.took_s.clear()
    path.run(40)
    one_in_ten_s = statistics.quantiles(path.took_s, n=10)[0]
    assert one_in_ten_s < 24_000 / path.rate + path.base_s + 3 * LOOK_S


FIRST_WINDOW = 10 * SEGMENT
# Shorter than any test lets bytes be under way.
RTT_S = 0.001


def at(at_s, written):
    return Reading(at_s, written, 0, 0.04, 0.04, 1448)


def test_a_bucket_keeps_little_that_nobody_wanted():
    """A frame after a pause is no burst of all that could have gone meanwhile."""
    bucket = TokenBucket(5.0, 0)
    assert bucket.fill(9.0, 100_000, has_waited=False, least=0) == int(100_000 * SAVED_S)
    assert bucket.fill(99.0, 100, has_waited=False, least=2048) == 2048


class Connection:
    """A media connection whose ssh writes what it is handed, and whose path delivers when it is told to."""

    def __init__(self):
        self.written = 5000
        self.arrived = 5000
        self.known = True

    def read_state(self, _, now_s):
        if not self.known:
            return None
        return Reading(now_s, self.written, self.arrived, RTT_S, RTT_S, SEGMENT)


@pytest.fixture
def connection():
    return Connection()


@pytest.fixture
def pacer(connection):
    made = Pacer(connection.read_state)
    with socket.socket() as handle:
        made._connection = handle
        yield made
        made.hold()


class Taker:
    def __init__(self, pacer, connection=None, *, is_bulk=False):
        self.got = 0
        self._is_bulk = is_bulk
        self._pacer = pacer
        self._connection = connection
        self.task = asyncio.ensure_future(self._run())

    async def _run(self):
        while True:
            granted = await self._pacer.acquire(MAX_TURN_BYTES, is_bulk=self._is_bulk)
            self.got += granted
            if self._connection is not None:
                self._connection.written += granted
            await asyncio.sleep(0)

    async def end(self):
        self.task.cancel()
        await asyncio.gather(self.task, return_exceptions=True)


async def test_no_more_than_the_window_gets_in_flight(pacer, connection):
    taker = Taker(pacer, connection)
    await eventually(lambda: taker.got >= FIRST_WINDOW - 2048, lambda: f"got {taker.got}")
    await asyncio.sleep(0.02)
    assert taker.got <= FIRST_WINDOW
    connection.arrived = connection.written
    await eventually(lambda: taker.got > FIRST_WINDOW, lambda: f"got {taker.got}")
    await taker.end()


async def test_what_ssh_still_has_counts(pacer, connection):
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


async def test_streams_share_fairly(pacer, connection):
    takers = [Taker(pacer, connection) for _ in range(3)]

    def all_got(amount):
        connection.arrived = min(connection.written, connection.arrived + 20_000)
        return sum(taker.got for taker in takers) > amount

    await eventually(lambda: all_got(300_000), lambda: f"got {[t.got for t in takers]}")
    for taker in takers:
        await taker.end()
    got = [taker.got for taker in takers]
    assert max(got) - min(got) <= 3 * MAX_TURN_BYTES


async def test_bulk_leaves_others_three_turns_in_four(pacer, connection):
    """However many wait with it; and it gets all that nobody else wants."""
    bulk = [Taker(pacer, connection, is_bulk=True) for _ in range(10)]
    video = Taker(pacer, connection)

    def sent():
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


async def test_without_a_connection_everybody_gets_all(caplog):
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


def look(connection):
    return read(connection, 7.0)


def test_tells_what_was_written_and_what_arrived(pair):
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
