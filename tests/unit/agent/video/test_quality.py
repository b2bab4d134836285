"""Steps of quality over simulated links, and what an encoder makes of them."""

import itertools
from dataclasses import dataclass, field
from math import inf

import pytest
from robotether_agent.video.encoding import MIN_SLOWED_FPS, LoadSteps, encoded_size
from robotether_agent.video.quality import RATES, SCALES, Level, Steps, ladder
from robotether_common.frames import StreamRequest


def levels_of(low, high, *, scales=False):
    return ladder(StreamRequest(low, high), scales=scales)


LEVELS = levels_of(20, 80, scales=True)
LATENCY_S = 0.3
FPS = 15


@dataclass
class FakeLink:
    """Takes one frame after the other: its round trip, and its bytes at so many a second."""

    bytes_s: float
    round_trip_s: float = 0.04
    # What a frame of quality 100 at its whole size has.
    whole: int = 60_000
    sizes: list[int] = field(default_factory=list)

    def took_s(self, level):
        self.sizes.append(int(self.whole * level.quality / 100 * level.scale**2))
        return self.round_trip_s + self.sizes[-1] / self.bytes_s


def drive(steps, link, from_s, seconds):
    changes = []
    now_s, looked_s, sent = from_s, from_s, 0
    while now_s < from_s + seconds:
        level = steps.level
        took_s = link.took_s(level)
        now_s += max(took_s, 1 / (FPS * level.rate))
        sent += 1
        steps.on_taken(now_s, took_s)
        if now_s - looked_s >= 1:
            steps.on_rates(now_s, FPS * level.rate, sent / (now_s - looked_s))
            looked_s, sent = now_s, 0
        if steps.level != level:
            changes.append((now_s, steps.level))
    return changes


@pytest.mark.parametrize(
    ("fps", "rates"), [(30.0, [1, *RATES]), (15.0, [1, 0.67, 0.5]), (7.0, [1]), (1.0, [1])]
)
def test_sharp_lowers_the_rate_before_the_quality_and_never_below_five_a_second(fps, rates):
    levels = ladder(StreamRequest(40, 60, fps, prefers="sharp"), scales=True)
    assert [level.rate for level in levels if level.quality == 60] == rates
    assert [level.quality for level in levels][-5:] == [50, 40, 40, 40, 40]
    assert [level.scale for level in levels][-3:] == list(SCALES)
    assert {level.rate for level in levels[len(rates) :]} == {rates[-1]}


def test_a_slow_link_gets_what_it_carries_within_seconds():
    steps, link = Steps(LEVELS, LATENCY_S, 0), FakeLink(0.62e6, whole=400_000)
    changes = drive(steps, link, 0, 120)
    assert changes[0][0] < 3
    assert link.round_trip_s + link.sizes[-1] / link.bytes_s <= LATENCY_S
    # Ways up that led down again come ever later.
    assert len([at for at, _ in changes if at > 60]) <= 4


def test_the_size_goes_only_when_the_quality_is_at_its_least():
    steps = Steps(LEVELS, LATENCY_S, 0)
    seen = [level for _, level in drive(steps, FakeLink(20_000), 0, 120)]
    assert seen[-1] == LEVELS[-1]
    assert all(level.quality == 20 for level in seen if level.scale < 1)


def test_a_link_that_gets_better_gets_the_best_again():
    steps = Steps(LEVELS, LATENCY_S, 0)
    drive(steps, FakeLink(100_000), 0, 20)
    assert steps.level.quality < 50
    changes = drive(steps, FakeLink(12e6), 20, 200)
    assert steps.level == LEVELS[0]
    gaps = [after[0] - before[0] for before, after in itertools.pairwise(changes)]
    assert min(gaps) >= 4


def test_a_rate_that_the_round_trip_limits_keeps_its_quality():
    """At 0.2 s there and back, smaller frames would come no more often, so the quality goes back up."""
    steps, link = Steps(LEVELS, LATENCY_S, 0), FakeLink(12e6, round_trip_s=0.2)
    changes = drive(steps, link, 0, 25)
    assert [level for _, level in changes] == [LEVELS[1], LEVELS[0]]


@pytest.mark.parametrize(("most", "level"), [(50, Level(50)), (10, Level(20))])
def test_a_full_line_gets_at_once_what_it_carries_and_more_is_tried_later(most, level):
    steps, wide = Steps(LEVELS, LATENCY_S, 0), FakeLink(12e6)
    assert steps.on_full_line(0, lambda level: level.quality <= most)
    assert steps.level == level
    assert drive(steps, wide, 0, 10) == []
    assert drive(steps, wide, 10, 6) != []


def test_a_stall_of_a_line_lowers_no_quality():
    steps = Steps(LEVELS, LATENCY_S, 0)
    for carried in (80, 10, 10, 10, 80, 10):
        assert not steps.on_full_line(0, lambda level, carried=carried: level.quality <= carried)
    assert steps.level == LEVELS[0]


def test_a_rate_that_bytes_limit_steps_down():
    """Each frame within the wanted time, but fewer than the camera gives."""
    steps, link = Steps(LEVELS, 1.0, 0), FakeLink(0.3e6, round_trip_s=0.01)
    drive(steps, link, 0, 40)
    assert steps.level.quality < 60
    sharp = Steps(ladder(StreamRequest(prefers="sharp"), scales=True), 1.0, 0)
    drive(sharp, link, 0, 40)
    assert sharp.level.quality >= 70
    assert sharp.level.rate < 1


@pytest.mark.parametrize(("low", "high", "at"), [(20, 40, 40), (20, 90, 60), (70, 90, 70)])
def test_another_range_goes_on_near_where_it_was(low, high, at):
    steps = Steps(LEVELS, LATENCY_S, 0)
    steps.on_taken(1.0, 1.0)
    steps.on_taken(2.0, 1.0)
    assert steps.level.quality == 60
    steps.use(levels_of(low, high), LATENCY_S, 3.0)
    assert steps.level.quality == at


INTERVAL_S = 1 / 15


@pytest.mark.parametrize(
    ("own", "requested", "scale", "size"),
    [
        ((640, 480), None, 1.0, (640, 480)),
        ((641, 361), None, 1.0, (640, 360)),
        ((1280, 720), (640, 480), 1.0, (640, 360)),
        ((640, 480), (1280, 960), 0.5, (320, 240)),
        ((1280, 720), (640, 360), 0.35, (224, 126)),
        ((30, 2000), None, 0.35, (16, 700)),
        # No robot encodes more, and no page decodes longer sides.
        ((7680, 4320), None, 1.0, (1920, 1080)),
        ((3840, 2160), (3840, 2160), 0.5, (1920, 1080)),
        ((8192, 200), None, 1.0, (4096, 100)),
    ],
)
def test_a_size_keeps_the_cameras_shape_and_never_grows(own, requested, scale, size):
    assert encoded_size(own, requested, scale) == size


class Clock:
    """A camera of 15 frames a second, whose encoder takes a part of each interval."""

    def __init__(self):
        self.now_s = 0.0
        self.steps = LoadSteps(0.0)

    def run(self, seconds, share):
        """Let frames come for a while; return whether the encoder kept up."""
        keeps, end_s = True, self.now_s + seconds
        while self.now_s < end_s - INTERVAL_S / 2:
            fps = min(15, self.steps.max_fps)
            self.now_s += 1 / fps
            keeps = self.steps.on_encoded(self.now_s, share * INTERVAL_S, fps) and keeps
        return keeps


BUSY, ROOM = (1.5, 0.5), 0.05


@pytest.mark.parametrize(
    ("runs", "preset"),
    [
        ([(10, 0.25)], "veryfast"),
        ([(10, 0.25), (1, 0.5)], "superfast"),
        ([(10, 0.25), (1, 0.5), (1, 0.5)], "ultrafast"),
        # One slow frame changes nothing.
        ([(2, 0.1), (1 / 15, 20), (2, 0.1)], "veryfast"),
        # A change costs a key frame: it waits for half a minute of room, or a minute if the last one was wrong.
        ([BUSY, (25, ROOM)], "superfast"),
        ([BUSY, (25, ROOM), (10, ROOM)], "veryfast"),
        ([BUSY, (25, ROOM), (10, ROOM), (1, 0.5), (50, ROOM)], "superfast"),
        ([BUSY, (25, ROOM), (10, ROOM), (1, 0.5), (50, ROOM), (15, ROOM)], "veryfast"),
        # That is forgotten once a step up has been right for long.
        ([BUSY, (35, ROOM), (1, 0.5), (70, ROOM), (620, 0.2), (0.8, 0.5), (35, ROOM)], "veryfast"),
    ],
)
def test_the_preset_follows_the_processor(runs, preset):
    clock = Clock()
    for seconds, share in runs:
        assert clock.run(seconds, share)
    assert clock.steps.preset == preset
    assert clock.steps.max_fps == inf


@pytest.mark.parametrize(
    ("runs", "fps"),
    [
        ([(20, 0.5)], inf),
        # Not at once, and then to a rate that leaves room.
        ([(3, 0.5), (2, 0.8), (1, 0.5), (2, 0.8)], inf),
        ([(3, 0.5), (15, 0.8)], 7.5),
        ([(3, 0.5), (15, 1.5)], MIN_SLOWED_FPS),
        # It stays while there is no room, and goes up in steps while there is.
        ([(3, 0.5), (15, 0.8), (120, 0.6)], 7.5),
        ([(3, 0.5), (15, 0.8), (35, 0.2)], 11.25),
        ([(3, 0.5), (15, 0.8), (140, 0.2)], inf),
        # A step that was wrong is tried again ever later.
        ([(3, 0.5), (15, 0.8), (35, 0.3), (15, 0.9), (50, 0.3)], 6.8),
    ],
)
def test_an_overloaded_encoder_gets_fewer_frames_until_there_is_room(runs, fps):
    clock = Clock()
    for seconds, share in runs:
        assert clock.run(seconds, share)
    assert clock.steps.preset == "ultrafast"
    assert clock.steps.max_fps == pytest.approx(fps, rel=0.1)


def test_an_encoder_that_is_overloaded_at_the_lowest_rate_is_given_up():
    clock = Clock()
    assert clock.run(15, 1.5)
    assert not clock.run(15, 2.0)
