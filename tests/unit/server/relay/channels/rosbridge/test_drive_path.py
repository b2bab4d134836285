"""Drive commands on their way to the guard: stamps, ages, the newest one first, and the drive's books."""

import asyncio
import json
import math
import struct
import time
from collections import Counter
from types import SimpleNamespace

import pytest
import pytest_asyncio
from relay_clients import PUBLISH
from relay_server import until, utc
from robotether_server.db.control import DriveEntry
from robotether_server.relay.channels.rosbridge.drive_path import (
    MAX_PINGS_OPEN,
    CommandTimestamps,
    DriveLease,
    DrivePath,
)
from robotether_server.relay.channels.rosbridge.message_validator import MessageValidator
from robotether_server.relay.http.timing import RobotClock
from robotether_server.relay.robots.drive_log import (
    LATENCY_STEP,
    MAX_LATENCY_MS,
    MIN_LATENCY_MS,
    DriveCounters,
    DriveLog,
    LatencyHistogram,
    ViewerCounts,
)
from robotether_server.relay.robots.robot import SeenReport
from robotether_server.settings.robot import DEFAULTS

NOON = utc(2026, 1, 1, 12, 0)


def stamps(robot):
    return [json.loads(data)["robotether"] for data in robot.received]


async def test_a_command_carries_its_timestamp_on_the_robots_clock(guarded, program):
    async with program() as ann:
        await ann.clock_sync()
        timestamp_ms = guarded.session.clock_ms() - 100
        await ann.drive(0.5, age_ms=100)
        await until(lambda: guarded.received, "the command came")
    (stamp,) = stamps(guarded)
    assert stamp["fence"] == 1
    assert timestamp_ms - 100 < stamp["t_ms"] <= timestamp_ms + 20


async def test_a_command_names_the_robots_own_frames(relay, guarded, sim1, program):
    delivered = relay.relay.registry.ensure_robot(sim1.id).delivered_frames
    delivered.note(1, "/a", 41, 900)
    delivered.note(2, "/b", 7, 500)
    async with program() as ann:
        await ann.clock_sync()
        await ann.drive(0.5)
        for camera, frame in (("/a", 41), ("/a", 42), ("/b", 7), ("/c", 41), ("/a", None)):
            await ann.drive(0.5, seen=[{"camera": camera, "frame": frame}])
        await ann.drive(0.5, seen=[])
        await until(lambda: len(guarded.received) == 7, "the commands came")
    assert [stamp.get("seen") for stamp in stamps(guarded)] == [
        None,
        [{"camera": "/a", "frame": 900}],
        [{"camera": "/a", "frame": None}],
        [{"camera": "/b", "frame": None}],
        [{"camera": "/c", "frame": None}],
        [{"camera": "/a", "frame": None}],
        [],
    ]


async def test_the_wish_to_stand_is_never_too_old(guarded, program):
    """The guard stops the robot by it, long before the deadman's time."""
    async with program() as ann:
        await ann.clock_sync()
        await ann.drive(0.5, age_ms=900)
        await ann.drive(0.0, age_ms=900)
        await until(lambda: guarded.received, "it came")
    assert [json.loads(data)["msg"] for data in guarded.received] == [{"linear": {"x": 0.0}}]
    assert stamps(guarded)[0]["t_ms"] < guarded.session.clock_ms() - 900


async def test_a_client_that_answers_no_ping_cannot_drive_on(guarded, ros):
    async with ros(autoping=False) as socket:
        begun = time.monotonic()
        while time.monotonic() - begun < 0.9:
            await socket.send_str(PUBLISH)
            await asyncio.sleep(0.05)
        passed = len(guarded.received)
        await socket.send_str(PUBLISH)
        assert (await socket.receive()).type is not None
        assert len(guarded.received) == passed


class FullSocket:
    def __init__(self):
        self.full = True
        self.sent = []

    def waiting_bytes(self):
        return int(self.full)

    async def send_frame(self, data, _kind):
        self.sent.append(data)


def command(speed, topic="/cmd_vel", msg=None):
    policy = DEFAULTS.policy
    validator = MessageValidator(policy.drive, DEFAULTS.guard.drive_topics, policy.limits)
    message = {"op": "publish", "topic": topic, "msg": msg or {"linear": {"x": speed}}}
    return validator.check(json.dumps(message).encode()).drive


@pytest.fixture
def reports():
    return []


def drive_log(*counters, fence=1, **options):
    entry = DriveEntry(7, "sim1", "ann", fence, NOON)
    return DriveLog(entry, 0.5, Counter(), *counters, **options)


@pytest.fixture
def log():
    return drive_log()


@pytest.fixture
def socket():
    return FullSocket()


def new_path(socket, log, reports, *, max_age_s=0.5, clock=None):
    lease = DriveLease(
        fence=1,
        max_age_s=max_age_s,
        clock=clock,
        log=log,
        on_command=lambda: None,
        on_report=reports.append,
    )
    return DrivePath(lease, socket, CommandTimestamps(time.monotonic()))


@pytest_asyncio.fixture
async def path(request, socket, log, reports):
    path = new_path(socket, log, reports, max_age_s=getattr(request, "param", 0.5))
    running = asyncio.create_task(path.run())
    yield path
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


async def test_only_the_newest_command_of_a_topic_waits(path, socket, log, reports):
    for speed in (0.1, 0.2, 0.3):
        await path.submit(command(speed))
    await path.submit(command(1.0, "/arm/cmd_vel"))
    # What waits was not sent: the watch must see that the robot takes nothing.
    assert [report.outcome for report in reports] == ["replaced", "replaced"]
    socket.full = False
    await until(lambda: len(socket.sent) == 2, "the newest of both went")
    assert [report.size for report in reports[2:]] == [len(data) for data in socket.sent]
    assert [json.loads(data)["msg"]["linear"]["x"] for data in socket.sent] == [0.3, 1.0]
    assert log.entry.dropped_old == 2


@pytest.mark.parametrize(
    ("drive", "stands"), [({"steering_angle": 0.3}, True), ({"acceleration": 1.0}, False)]
)
def test_a_car_that_follows_the_rates_alone_does_not_stand(drive, stands):
    assert command(0.0, msg={"drive": drive}).stands is stands


async def test_of_commands_of_unknown_age_the_zero_alone_goes(socket, log, reports):
    """The guard stops the robot by it, long before the deadman's time."""
    path = new_path(socket, log, reports, clock=RobotClock())
    socket.full = False
    for speed in (0.5, 0.0):
        await path.submit(command(speed))
    assert [report.outcome for report in reports] == ["clock_unknown", "sent"]
    (sent,) = map(json.loads, socket.sent)
    assert (sent["msg"]["linear"]["x"], sent["robotether"]["t_ms"]) == (0.0, 0.0)


@pytest.mark.parametrize("path", [0.1], indirect=True)
async def test_a_command_that_waited_too_long_does_not_go(path, socket, log):
    await path.submit(command(0.1))
    await asyncio.sleep(0.15)
    socket.full = False
    await until(lambda: log.entry.dropped_old == 1, "it is dropped")
    assert socket.sent == []


async def test_many_topics_do_not_make_a_queue(path):
    for number in range(50):
        await path.submit(command(0.1, f"/r{number}/cmd_vel"))
    assert len(path._waiting) == 8


def test_a_pong_says_that_what_follows_is_younger_than_its_ping():
    timestamps = CommandTimestamps(0.0)
    first, second, third = (timestamps.ping(float(at)) for at in (1, 2, 3))
    for pong, sent_s, counts_s in ((second, 2.0, 2.0), (first, None, 2.0), (third, 3.0, 3.0)):
        assert timestamps.pong(pong) == sent_s
        for payload in (b"", b"x", struct.pack("!Q", 99), struct.pack("!Q", 0)):
            assert timestamps.pong(payload) is None
        assert timestamps.of(None, 4.0) == counts_s


def test_a_stamp_counts_and_is_never_to_come():
    """Clocks drift a little; the commands of a client with a wrong clock would be young however late they come."""
    timestamps = CommandTimestamps(1.0)
    assert timestamps.of(2500.0, 4.0) == 2.5
    assert timestamps.of(4050.0, 4.0) == 4.0
    assert timestamps.of(4251.0, 4.0) is None
    assert timestamps.of(2.0**53, 4.0) is None


def test_open_pings_are_bounded():
    timestamps = CommandTimestamps(0.0)
    first = timestamps.ping(1.0)
    for at in range(2 * MAX_PINGS_OPEN):
        timestamps.ping(2.0 + at)
    timestamps.pong(first)
    assert timestamps.of(None, 999.0) == 0.0
    assert len(timestamps._open) == MAX_PINGS_OPEN


@pytest.mark.parametrize(
    ("commands", "distance_m", "turned_rad", "top"),
    [
        ([(10.0, 1.0, 0.5), (10.2, 2.0, 0.1)], 0.4, 0.11, (2.0, 0.5)),
        # After the deadman the robot stands, however long the silence.
        ([(0.0, 1.0, 0.0), (10.0, 0.0, 0.0)], 0.5, 0, (1.0, 0)),
        # How far a steered robot turned is unknown from its first motion on.
        ([(10.0, 0.0, None)], 0, 0, (0, 0)),
        ([(10.0, 0.0, None), (10.1, 1.0, None), (10.2, 1.0, 0.5)], 0.2, None, (1.0, None)),
    ],
)
def test_a_command_counts_until_the_next(log, commands, distance_m, turned_rad, top):
    for command in commands:
        log.command(*command)
    entry = log.end(10.3, NOON, "client_left")
    assert entry.distance_m == pytest.approx(distance_m)
    assert entry.turned_rad == pytest.approx(turned_rad)
    assert (entry.top_speed_m_s, entry.top_turn_rad_s) == top


def test_what_the_driver_saw_is_counted_by_its_age():
    shown = []
    log = drive_log(fence=5, show_seen=shown.append)
    log.on_seen(SeenReport(4, (9000.0,)))
    log.on_seen(SeenReport(5, ()))
    entry = log.written()
    assert (entry.seen_p50_ms, entry.seen_max_ms, entry.seen_unknown) == (None, None, None)
    log.on_seen(SeenReport(5, (None,)))
    entry = log.written()
    assert (entry.seen_p50_ms, entry.seen_max_ms, entry.seen_unknown) == (None, None, 1)
    log.on_seen(SeenReport(5, (140.2,) * 94))
    log.on_seen(SeenReport(5, (200.0,) * 4 + (512.3, 480.0, None)))
    entry = log.end(1.0, NOON, "client_left")
    assert entry.seen_p50_ms == pytest.approx(140.2, rel=0.01)
    assert entry.seen_p95_ms == pytest.approx(200, rel=0.01)
    assert entry.seen_p99_ms == pytest.approx(480, rel=0.01)
    assert (entry.seen_max_ms, entry.seen_unknown) == (512.3, 2)
    assert [report.ages_ms[-1] for report in shown] == [None, 140.2, None]
    # An older guard does not report whether it slows commands.
    assert entry.slowed_s is None
    for slowed_s, in_all_s in ((0.0, 0), (0.45, 0.45), (0.05, 0.5)):
        log.on_seen(SeenReport(5, (), slowed_s))
        assert log.written().slowed_s == in_all_s


def test_figures_are_those_of_the_drive():
    """Of bytes and frames it counts what came since its start, of positions that of start and end."""
    positions = iter([(1.0, 2.0), None, (3.0, 4.0)])
    now = SimpleNamespace(bytes=0, rtt_ms=None, viewer_counts=ViewerCounts(100, 5000, 60.0))
    counters = DriveCounters(
        lambda: now.bytes,
        lambda: now.rtt_ms,
        lambda: now.viewer_counts,
        position=lambda: next(positions),
    )
    log = drive_log(counters)
    log.round_trip(10.0)
    now.bytes, now.rtt_ms, now.viewer_counts = 700, 20.0, ViewerCounts(130, 8000, 62.5)
    entry = log.written()
    assert (entry.bytes, entry.frames, entry.frame_bytes, entry.viewed_s) == (700, 30, 3000, 2.5)
    assert (entry.latency_p50_ms, entry.start_x_m, entry.end_x_m) == (None, 1.0, None)
    for latency_ms in [10.0] * 94 + [180.0] * 6:
        log.round_trip(latency_ms)
    log.end(1.0, NOON, "client_left")
    now.bytes, now.viewer_counts = 900, ViewerCounts(999, 99_999, 999.0)
    log.refused_by_guard({"old": 1})
    entry = log.written()
    assert (entry.bytes, entry.frames, entry.refused) == (700, 30, {"guard_old": 1})
    assert (entry.start_x_m, entry.end_x_m, entry.end_y_m) == (1.0, 3.0, 4.0)
    assert entry.latency_p50_ms == pytest.approx(30, rel=0.012)
    assert entry.latency_p95_ms == pytest.approx(200, rel=0.012)


def test_memory_is_bounded_whatever_comes():
    """Clocks that jump make the least or the most of all times."""
    latency = LatencyHistogram()
    for value in (*(10.0**power for power in range(-300, 300)), 0.0, -5.0, float("inf")):
        latency.add(value)
    assert len(latency._counts) <= math.log(MAX_LATENCY_MS / MIN_LATENCY_MS) / LATENCY_STEP + 2
    assert latency.quantile(0.99) == pytest.approx(MAX_LATENCY_MS, rel=0.01)
