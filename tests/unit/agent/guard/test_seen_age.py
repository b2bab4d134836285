"""How old is what a driver sees, and the speed that falls with it."""

import json
import random
from dataclasses import replace

import pytest
from controller_world import CONFIG, FakePublisher, FakeSource, World
from robotether_agent.guard.drive_controller import SLOWED_EVERY_S
from robotether_agent.guard.drive_messages import MAX_STEP_S, DriveLimits
from robotether_agent.guard.seen_age import (
    HALVED_IN_S,
    MAX_AGES,
    MAX_CAMERAS,
    BlindLimits,
    DriverView,
    FrameTimes,
    LimitingAge,
    SeenAges,
    SeenFrames,
)
from robotether_common.guard import MAX_FRAMES, MAX_SEEN_FRAMES, MAX_SEEN_S, MAX_SLOWED_S

NOW = 1000.0


@pytest.fixture
def times():
    times = FrameTimes()
    times.note("/a", 1, NOW - 0.3, NOW - 0.2)
    times.note("/a", 2, NOW - 0.2, NOW - 0.1)
    times.note("/b", 2, NOW - 0.9, NOW)
    return times


def view(camera, frame):
    return {"camera": camera, "frame": frame}


def test_of_several_views_the_oldest_counts(times):
    assert times.oldest_s([view("/a", 2)], NOW) == NOW - 0.2
    assert times.oldest_s([view("/a", 2), view("/b", 2), view("/a", 1)], NOW) == NOW - 0.9


@pytest.mark.parametrize(
    "forged",
    [
        [view("/a", 3)],
        [view("/a", 2), view("/a", 3)],
        [view("/c", 2)],
        [view("/a", None)],
        [view("/a", True)],
        [view("/a", 2.0)],
        [view("/a", "2")],
        [view(["/a"], 2)],
        [view("/a", [2])],
        [2],
        [],
        {},
        None,
        "/a",
        [view("/a", 2)] * (MAX_SEEN_FRAMES + 1),
    ],
)
def test_what_did_not_leave_the_robot_is_unknown(times, forged):
    """A known frame beside it changes nothing, and a stranger may write any type."""
    assert times.oldest_s(forged, NOW) is None


@pytest.mark.parametrize(
    ("seen", "may_follow"),
    [
        ([view("/a", 3)], True),
        ([view("/a", 2), view("/c", 1)], True),
        ([view("/a", 2)], False),
        ([view("/a", None)], False),
        ([view("/a", 3), view("/b", None)], False),
        ([2], False),
        ([], False),
        (None, False),
    ],
)
def test_only_a_frame_with_a_number_may_be_reported_yet(times, seen, may_follow):
    assert times.may_follow(seen, NOW) is may_follow


def test_an_old_frame_is_unknown(times):
    assert times.oldest_s([view("/a", 2)], NOW - 0.2 + MAX_SEEN_S) == NOW - 0.2
    assert times.oldest_s([view("/a", 2)], NOW - 0.1 + MAX_SEEN_S) is None


def test_of_two_frames_of_one_number_the_older_counts(times):
    """Receivers of a camera could use one number at the same time; no frame is of the future."""
    times.note("/a", 2, NOW - 0.05, NOW)
    assert times.oldest_s([view("/a", 2)], NOW) == NOW - 0.2
    times.note("/a", 5, NOW + 3, NOW)
    assert times.oldest_s([view("/a", 5)], NOW) == NOW


def test_memory_of_frames_is_bounded():
    times = FrameTimes()
    for number in range(MAX_FRAMES + 1):
        times.note("/a", number, NOW, NOW)
    assert times.oldest_s([view("/a", 0)], NOW) is None
    assert times.oldest_s([view("/a", 1)], NOW) == NOW
    for number in range(MAX_CAMERAS):
        times.note(f"/{number}", 1, NOW, NOW)
    assert times.oldest_s([view("/a", 1)], NOW) is None
    assert times.oldest_s([view("/0", 1)], NOW) == NOW
    times.note("/0", 2, NOW - MAX_SEEN_S - 1, NOW + 1)
    times.note("/0", 3, NOW + 20, NOW + 20)
    assert len(times._cameras["/0"]) == 1


def seen_frames(taken_s):
    return SeenFrames(taken_s, DriverView(), 13)


def test_an_age_is_never_negative():
    assert seen_frames(NOW).age_s(NOW - 0.01) == 0
    assert seen_frames(NOW).age_s(NOW + 0.14) == pytest.approx(0.14)
    assert seen_frames(None).age_s(NOW) is None


def test_ages_are_of_one_drive():
    ages = SeenAges()
    for age_s in (0.14, None):
        ages.begin(13)
        ages.add(age_s)
    ages.slowed_s, ages.limits = 0.05, (0.52, 1.0)
    assert (ages.fence, ages.ages_ms) == (13, [140.0, None])
    ages.begin(14)
    ages.add(0.2)
    assert (ages.fence, ages.ages_ms, ages.slowed_s, ages.limits) == (14, [200.0], 0.0, None)


def test_a_time_beyond_its_bound_is_reported_as_the_bound():
    """The relay counts no more; older ones end a session for it."""
    ages = SeenAges()
    ages.begin(13)
    ages.slowed_s = 1e9
    assert ages.report()["slowed_s"] == MAX_SLOWED_S


@pytest.mark.parametrize("first", [0.0, 0.1])
@pytest.mark.parametrize("worst", [9.0, None])
def test_the_worst_age_is_never_lost(worst, first):
    ages = SeenAges()
    for age_s in [first] * (MAX_AGES + 5) + [worst] + [0.1] * 5:
        ages.add(age_s)
    assert len(ages.ages_ms) == MAX_AGES
    assert ages.ages_ms[-1] == (None if worst is None else 9000)


LIMITS = BlindLimits(blind_m=0.25, blind_rad=0.5, camera_s=0.04)
ACCELERATION = 2.0


def test_the_age_that_limits_rises_at_once_and_falls_smoothly():
    age = LimitingAge()
    assert age.at(0.2, 1000.0) == 0.2
    assert age.at(0.8, 1000.05) == 0.8
    assert age.at(0.1, 1000.05 + HALVED_IN_S) == pytest.approx(0.4)
    assert age.at(0.3, 1000.05 + 2 * HALVED_IN_S) == 0.3
    assert age.at(None, 1001.0) == MAX_SEEN_S
    # A clock that does not go on changes nothing.
    assert age.at(0.1, 1001.0) == age.at(0.1, 1000.0) == MAX_SEEN_S


class SeeingWorld(World):
    """A guard that limits what is driven unseen, and a camera whose frames are known."""

    def __init__(self, blind=LIMITS, limits=None):
        super().__init__()
        self.controller.use(
            replace(
                CONFIG, deadman_s=2.0, max_age_s=2.0, blind=blind, limits=limits or DriveLimits()
            )
        )
        self.frame = 0
        self.taken_s = 0.0

    def take(self, age_s):
        self.frame += 1
        self.taken_s = self.now - age_s
        self.controller.frame_times.note("/a", self.frame, self.taken_s, self.now)

    async def see(self, speed, frame=None, turn=0.0, **more):
        """Send a command that names this frame, or the newest."""
        seen = [{"camera": "/a", "frame": frame or self.frame}]
        stamp = {"t_ms": self.now * 1000, "fence": 13, "seen": seen}
        msg = {"linear": {"x": speed}, "angular": {"z": turn}}
        await self.drive(speed, robotether=stamp, msg=msg, **more)

    @property
    def turns(self):
        return [m["msg"]["angular"]["z"] for m in self.publisher.sent if m["op"] == "publish"]


async def test_a_driver_who_sees_late_drives_slowly():
    world = SeeingWorld()
    world.take(0.21)
    await world.see(3.0, turn=5.0)
    assert world.publisher.speeds == [pytest.approx(1.0)]
    assert world.turns == [pytest.approx(2.0)]
    assert world.controller.seen_ages.limits == (pytest.approx(1.0), pytest.approx(2.0))
    await world.see(0.5)
    assert world.publisher.speeds[-1] == 0.5
    assert world.controller.seen_ages.limits is None


STRICT = replace(LIMITS, needs_frames=True)
SLOWEST = 0.25 / (MAX_SEEN_S + 0.04)


@pytest.mark.parametrize(
    ("blind", "frames", "speeds"),
    [
        (LIMITS, [99], [SLOWEST]),
        (LIMITS, [-1], [SLOWEST]),
        # Who names none any more sees nothing.
        (LIMITS, [1, None], [1.0, SLOWEST]),
        (STRICT, [None], [SLOWEST]),
    ],
)
async def test_an_unknown_view_has_the_slowest_speed(blind, frames, speeds):
    world = SeeingWorld(blind)
    world.take(0.1)
    for frame in frames:
        await (world.drive(1.0) if frame is None else world.see(1.0, frame))
    assert world.publisher.speeds == pytest.approx(speeds)
    assert world.controller.seen_ages.ages_ms[-1] is None


@pytest.mark.parametrize(("blind", "frame"), [(LIMITS, None), (BlindLimits(), 99)])
async def test_who_never_named_a_frame_or_has_no_limit_drives_as_before(blind, frame):
    world = SeeingWorld(blind)
    await (world.drive(3.0) if frame is None else world.see(3.0, frame))
    await world.pass_time(1.9)
    assert world.publisher.speeds == [3.0]
    assert world.controller.seen_ages.slowed_s == 0
    assert world.controller.seen_ages.ages_ms == ([] if frame is None else [None])


async def test_a_zero_is_a_zero_however_old_the_view_is():
    world = SeeingWorld()
    await world.see(1.0, 99)
    await world.see(0.0, 99)
    assert world.publisher.speeds[-1] == 0.0
    assert not world.controller.moving


async def test_a_rise_of_the_age_is_in_force_within_100_ms():
    """When no command comes, the last one goes out again, ever slower, until the deadman's zeros."""
    world = SeeingWorld()
    world.take(0.1)
    await world.see(1.0)
    sent_at = world.now
    late = []
    while world.controller.moving and world.now < sent_at + 1.95:
        await world.pass_time(0.01)
        speed, age_s = world.publisher.speeds[-1], world.now - world.taken_s + LIMITS.camera_s
        late.append(speed * (age_s - SLOWED_EVERY_S - 0.011) <= 0.25)
    assert all(late)
    assert world.publisher.speeds[-1] < 0.15
    assert world.publisher.speeds == sorted(world.publisher.speeds, reverse=True)
    assert len(world.publisher.speeds) <= 1.95 / SLOWED_EVERY_S + 1
    await world.pass_time(2.0)
    assert world.publisher.speeds[-10:] == [0.0] * 10


async def test_the_guard_wakes_to_slow_a_command_and_sleeps_again():
    world = SeeingWorld()
    world.take(0.1)
    await world.see(1.0)
    assert world.controller._next_at() == pytest.approx(world.now + SLOWED_EVERY_S)
    await world.see(0.0)
    await world.pass_time(3.0)
    assert world.controller._next_at() is None
    await world.see(1.0, 99)
    await world.pass_time(2.0)
    world.controller.stop()
    await world.pass_time(3.0)
    assert world.controller._next_at() is None


async def test_nothing_is_repeated_after_the_end():
    for end in ("stop", "gone", "lease", "rosbridge"):
        world = SeeingWorld()
        world.take(0.1)
        await world.see(1.0)
        if end == "stop":
            world.authorizer.stop()
            world.controller.stop()
        elif end == "gone":
            world.controller.on_disconnected(world.source)
        elif end == "lease":
            world.authorizer.lease(13, held=False)
            world.controller.rights_changed()
        else:
            world.publisher.full = True
        await world.pass_time(1.0)
        assert set(world.publisher.speeds) <= {1.0, 0.0}, end


class Recorder(FakePublisher):
    def __init__(self, world):
        super().__init__()
        self.world = world
        self.outputs = []

    async def send(self, data):
        message = json.loads(data)
        if message["op"] == "publish":
            twist = message["msg"]
            speeds = twist["linear"]["x"], twist["angular"]["z"]
            self.outputs.append((self.world.now, message.get("id"), *speeds))
        return await super().send(data)


async def _random_drive(seed):
    chance = random.Random(seed)
    world = SeeingWorld(limits=DriveLimits(max_acceleration_m_s2=ACCELERATION))
    world.controller._publisher = recorder = Recorder(world)
    seen_at = {}
    for number in range(3000):
        recorder.full = chance.random() < 0.05
        if chance.random() < 0.7:
            world.take(chance.choice((0.05, 0.1, 0.1, 0.2, 0.2, 1.0)))
        if chance.random() < 0.6:
            is_known = world.frame > 0 and chance.random() < 0.99
            seen_at[str(number)] = world.taken_s if is_known else None
            wanted = chance.choice((1.0, 3.0, 3.0, 3.0, 3.0, 3.0, 3.0, -1.0, 0.0))
            frame = None if is_known else 10**6
            await world.see(wanted, frame, turn=wanted, id=str(number))
        await world.pass_time(chance.choice((0.01, 0.05, 0.05, 0.3)), 0.01)
    return recorder, seen_at


@pytest.mark.parametrize("seed", range(2))
async def test_no_output_of_the_guard_breaks_a_limit(seed):
    recorder, seen_at = await _random_drive(seed)
    newest = None
    last_at, last, repeated = 0.0, 0.0, 0
    for at, name, speed, turn in recorder.outputs:
        repeated += name is None and speed != 0
        newest = name or newest
        taken_s = seen_at[newest] if newest else None
        is_known = taken_s is not None and at - taken_s <= MAX_SEEN_S
        unseen_s = (at - taken_s if taken_s is not None and is_known else MAX_SEEN_S) + 0.04
        assert abs(speed) * unseen_s <= 0.25
        assert abs(turn) * unseen_s <= 0.5
        before = abs(last) if last * speed > 0 else 0.0
        assert abs(speed) <= before + ACCELERATION * min(at - last_at, MAX_STEP_S) + 1e-6
        last_at, last = at, speed
    assert repeated > 20
    assert max(abs(speed) for _, _, speed, _ in recorder.outputs) > 0.8


async def test_the_time_of_slow_driving_is_counted():
    world = SeeingWorld()
    world.take(0.5)
    await world.see(1.0)
    await world.pass_time(0.05)
    await world.see(0.1)
    assert world.controller.seen_ages.slowed_s == pytest.approx(0.05)
    world.take(0.5)
    await world.see(1.0)
    world.controller.stop()
    await world.pass_time(0.02)
    assert 0.05 < world.controller.seen_ages.slowed_s <= 0.08
    count = world.controller.seen_ages.slowed_s
    await world.pass_time(1.0)
    assert world.controller.seen_ages.slowed_s == count


async def test_a_direct_connection_is_slowed_and_belongs_to_no_drive():
    world = SeeingWorld(STRICT)
    world.authorizer.lease(13, held=False)
    world.authorizer.direct = True
    direct = FakeSource()
    direct.authorization = replace(direct.authorization, mode="direct", fence=0)
    await world.send(direct, op="publish", msg={"linear": {"x": 3}})
    await world.pass_time(0.3)
    assert world.publisher.speeds == [pytest.approx(SLOWEST)]
    assert not world.controller.seen_ages.has_news
