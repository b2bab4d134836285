"""What goes on the publisher, with a line and a clock of the tests."""

import asyncio
import json
import os

import pytest
from controller_world import FakeSource, World
from hypothesis import given
from hypothesis import strategies as st
from robotether_agent.guard.agent_messages import LISTENERS_UNKNOWN, UNHEARD, GuardConfig
from robotether_agent.guard.drive_controller import (
    AHEAD_MS,
    REGISTERED_WITHIN_S,
    UNREGISTERED_AFTER_S,
)
from robotether_agent.guard.topics import (
    ZEROS,
    ZEROS_AFTER_RECONNECT,
    Authorization,
    Driven,
    MotionFile,
)
from sim_client import until


def counted(world):
    return {cause: count for cause, count in world.controller.stops.items() if count}


async def test_zeros_follow_when_commands_stop(world):
    await world.drive(0.5)
    await world.pass_time(0.45)
    assert world.publisher.speeds == [0.5]
    assert world.motion_file.read() == [Driven("/cmd_vel", "twist")]
    await world.pass_time(10)
    assert world.publisher.speeds == [0.5] + [0.0] * 10
    assert world.motion_file.read() is None
    assert not world.controller.moving
    assert counted(world) == {"silence": 1}


async def test_stop_by_the_driver_is_none_of_the_guard(world):
    await world.drive(0.5)
    await world.drive(0.0)
    await world.pass_time(10)
    world.controller.stop()
    world.controller.on_disconnected(world.source)
    assert counted(world) == {}


CAUSES = {
    "gone": "lost",
    "lease": "lost",
    "stop": "person",
    "session": "lost",
    "agent": "fault",
    "rosbridge": "fault",
}


@pytest.mark.parametrize("loss", CAUSES)
async def test_each_loss_is_a_stop_at_once(world, loss):
    world.controller.use(GuardConfig("ws://x", deadman_s=10))
    await world.drive(0.5)
    losses = {
        "gone": lambda: world.controller.on_disconnected(world.source),
        "lease": lambda: (
            world.authorizer.lease(13, held=False),
            world.controller.rights_changed(),
        )[1],
        "session": lambda: (world.authorizer.session(up=False), world.controller.rights_changed())[
            1
        ],
        "stop": lambda: (world.authorizer.stop(), world.controller.stop())[1],
        "agent": lambda: setattr(world, "now", world.authorizer.silent_at),
        "rosbridge": world.controller.on_rosbridge_lost,
    }
    losses[loss]()
    await world.controller.step()
    assert world.publisher.speeds == [0.5, 0.0]
    await world.pass_time(5)
    zeros = ZEROS_AFTER_RECONNECT if loss == "rosbridge" else ZEROS
    assert world.publisher.speeds == [0.5] + [0.0] * zeros
    assert counted(world) == {CAUSES[loss]: 1}


async def test_another_connections_end_is_no_stop(world):
    await world.drive(0.5)
    world.controller.on_disconnected(FakeSource(Authorization("observe")))
    await world.controller.step()
    assert world.publisher.speeds == [0.5]


async def test_a_stop_zeroes_what_stands(world):
    """Of topics that were driven; the guard knows no others."""
    await world.send(op="advertise", topic="/other/cmd_vel", type="geometry_msgs/Twist")
    await world.drive(0.0)
    world.controller.stop()
    await world.pass_time(5)
    assert world.publisher.speeds == [0.0] * 11
    assert {m["topic"] for m in world.publisher.sent if m["op"] == "publish"} == {"/cmd_vel"}


@pytest.mark.parametrize("t_ms", [None, "now", True, [], 10**400, -(10**400)])
async def test_a_command_without_a_time_is_refused(world, t_ms):
    await world.drive(0.5, robotether={"t_ms": t_ms, "fence": 13})
    await world.drive(0.5, robotether=3)
    assert world.publisher.sent == []
    assert world.source.kinds == ["old", "fence"]


def seen(world, *frames):
    views = [{"camera": "/a", "frame": frame} for frame in frames]
    return {"robotether": {"t_ms": world.now * 1000, "fence": 13, "seen": views}}


async def test_the_age_of_what_is_seen_counts_up_to_the_output(world):
    """The time in which rosbridge takes nothing included; of a zero nobody asks."""
    world.controller.frame_times.note("/a", 1, world.now - 0.1, world.now)
    world.publisher.full = True
    await world.drive(0.5, **seen(world, 1))
    assert world.controller.seen_ages.ages_ms == []
    world.now += 0.04
    world.publisher.full = False
    await world.controller.step()
    assert (world.controller.seen_ages.fence, world.controller.seen_ages.ages_ms) == (13, [140.0])
    await world.drive(0.0, **seen(world, 1))
    assert len(world.controller.seen_ages.ages_ms) == 1


async def test_a_client_that_names_no_frame_any_more_sees_nothing(world):
    """One that never named any is not asked; that of an unknown frame is unknown."""
    await world.drive(0.5)
    assert world.controller.seen_ages.ages_ms == []
    world.controller.frame_times.note("/a", 1, world.now - 0.1, world.now)
    await world.drive(0.5, **seen(world, 2))
    await world.drive(0.5, **seen(world, 1, 2))
    await world.drive(0.5, **seen(world))
    await world.drive(0.5)
    assert world.controller.seen_ages.ages_ms == [None] * 4
    await world.drive(0.5, FakeSource())
    await world.drive(0.5, **seen(world, 1))
    assert world.controller.seen_ages.ages_ms == [None] * 4 + [100.0]


async def test_a_frame_that_is_reported_with_its_command_is_known(world, spawn):
    """The agent's line came first, on a pipe that the guard has not read yet: so many turns it takes to be handled."""
    lines, loop = asyncio.StreamReader(), asyncio.get_running_loop()
    reading, writing = os.pipe()
    with os.fdopen(writing, "wb", 0) as pipe:
        protocol = asyncio.StreamReaderProtocol(lines)
        transport, _ = await loop.connect_read_pipe(lambda: protocol, os.fdopen(reading, "rb", 0))

        async def read():
            while await lines.readline():
                world.controller.frame_times.note("/a", 1, world.now - 0.1, world.now)

        spawn(read())
        for _ in range(10):
            await asyncio.sleep(0)
        pipe.write(b"frame\n")
        await world.drive(0.5, **seen(world, 1))
        assert world.controller.seen_ages.ages_ms == [100.0]
        transport.close()


async def test_a_refused_command_that_names_a_frame_counts_as_naming(world):
    stamp = {"t_ms": 0, "fence": 13, "seen": []}
    await world.drive(0.5, robotether=stamp)
    assert world.source.kinds == ["old"]
    await world.drive(0.5)
    assert world.controller.seen_ages.ages_ms == [None]


async def test_of_a_backlog_only_the_newest_command_waits(world):
    world.publisher.full = True
    for speed in range(1, 11):
        await world.drive(speed)
    world.publisher.full = False
    await world.controller.step()
    assert world.publisher.speeds == [10.0]
    assert world.controller.refusals["old"] == 9


async def test_an_old_command_takes_no_newer_ones_place(world):
    """It is refused when it comes, so that what waits for rosbridge still goes out."""
    world.publisher.full = True
    await world.drive(0.3)
    await world.drive(0.9, age_ms=600)
    world.publisher.full = False
    await world.controller.step()
    assert world.publisher.speeds == [0.3]
    assert world.source.kinds == ["old"]


@pytest.mark.parametrize(("age_ms", "wait_s"), [(400, 0.12), (-AHEAD_MS + 10, 0.51)])
async def test_a_command_that_waits_too_long_is_dropped(world, age_ms, wait_s):
    """Its age counts from when it was given, not from when it came, and a clock that is ahead adds nothing."""
    world.publisher.full = True
    await world.drive(0.5, age_ms=age_ms)
    await world.pass_time(wait_s)
    world.publisher.full = False
    await world.pass_time(1)
    assert world.publisher.sent == []
    assert world.source.kinds == ["old"]


async def test_a_direct_command_needs_no_time_and_is_dropped_when_it_waits_too_long(world):
    world.authorizer.lease(13, held=False)
    world.authorizer.direct = True
    direct = FakeSource(Authorization("direct"))
    world.publisher.full = True
    await world.send(direct, op="publish", msg={"linear": {"x": 1}})
    await world.pass_time(0.51)
    world.publisher.full = False
    await world.pass_time(1)
    assert world.publisher.sent == []
    assert direct.kinds == ["old"]
    await world.send(direct, op="publish", msg={"linear": {"x": 1}})
    assert world.publisher.speeds == [1.0]


@pytest.mark.parametrize("reason", ["old", "held"])
async def test_a_stop_of_the_driver_that_is_refused_is_the_guards(world, reason):
    """One that comes late, or while rosbridge reads nothing: the deadman's time may be seconds."""
    world.controller.use(GuardConfig("ws://x", deadman_s=10))
    await world.drive(0.5)
    world.publisher.full = True
    await world.drive(0.6)
    world.publisher.up = reason == "old"
    await world.drive(0.0, age_ms=600)
    assert world.source.kinds == [reason]
    world.publisher.full, world.publisher.up = False, True
    await world.pass_time(1)
    assert world.publisher.speeds == [0.5] + [0.0] * 10


async def test_a_stop_of_the_driver_as_another_type_is_the_guards(world):
    """The robot may not take that type: it would drive on for the deadman's time."""
    world.controller.use(GuardConfig("ws://x", deadman_s=10))
    await world.drive(0.5)
    await world.drive(0.0, msg={"header": {}, "twist": {}})
    assert world.source.kinds == ["shape"]
    await world.pass_time(1)
    assert world.publisher.speeds == [0.5] + [0.0] * 10


async def test_a_late_zero_of_another_moves_nothing_and_stops_nothing(world):
    await world.drive(0.5)
    await world.drive(0.0, FakeSource(Authorization("drive", 12)), age_ms=600)
    await world.drive(0.0, FakeSource(Authorization("observe")), age_ms=600)
    await world.controller.step()
    assert world.publisher.speeds == [0.5]


async def test_a_stop_of_the_driver_that_could_not_be_sent_is_the_guards(world):
    await world.drive(0.5)
    world.publisher.full = True
    await world.drive(0.0, age_ms=450)
    await world.pass_time(0.1)
    world.publisher.full = False
    await world.pass_time(0.1)
    assert world.publisher.speeds[:2] == [0.5, 0.0]


async def test_what_waits_is_forgotten_with_its_sender(world):
    world.publisher.full = True
    await world.drive(0.5)
    world.controller.on_disconnected(world.source)
    await world.drive(0.5)
    world.controller.halt()
    world.publisher.full = False
    await world.pass_time(1)
    assert world.publisher.sent == []


async def test_zeros_that_are_owed_come_before_commands(world):
    """A rosbridge that was away moves nobody before it has stopped everybody."""
    await world.drive(0.5)
    world.publisher.up = False
    world.controller.on_rosbridge_lost()
    await world.pass_time(3)
    world.publisher.up = True
    await world.drive(0.7)
    assert world.source.kinds == ["held"]
    world.controller.on_rosbridge_connected()
    await world.controller.step()
    await world.drive(0.7)
    assert world.publisher.speeds == [0.5, 0.0, 0.7]


async def test_zeros_that_are_owed_come_before_what_waits(world):
    await world.drive(0.5)
    world.publisher.full = True
    await world.pass_time(0.3)
    await world.drive(0.7, topic="/other/cmd_vel")
    await world.pass_time(0.21)
    world.publisher.full = False
    await world.controller.step()
    assert world.publisher.speeds == [0.5]
    await world.pass_time(0.05)
    assert world.publisher.speeds == [0.5, 0.0, 0.7]


async def test_a_line_that_breaks_under_a_command_owes_zeros(world):
    world.publisher.breaks = True
    await world.drive(0.5)
    world.controller.on_rosbridge_lost()
    world.publisher.breaks = False
    await world.pass_time(5)
    assert world.publisher.speeds == [0.0] * ZEROS_AFTER_RECONNECT


async def test_a_motion_that_cannot_be_noted_does_not_begin(tmp_path):
    """It begins once it can; until then the driver is told why."""
    world = World(MotionFile(tmp_path / "gone"))
    await world.drive(0.5)
    assert world.publisher.sent == []
    assert world.source.kinds == ["held"]
    assert f"cannot write {tmp_path}/gone/motion.json: No such" in world.source.refused[0][1]
    assert not world.controller.moving
    (tmp_path / "gone").mkdir()
    await world.drive(0.5)
    assert world.publisher.speeds == [0.5]


async def test_the_next_guard_zeroes_what_this_one_left(world):
    name = "geometry_msgs/msg/TwistStamped"
    world.motion_file.driven = [Driven("/base/cmd_vel", "twist_stamped", name, "base")]
    world.controller.resume()
    await world.pass_time(5)
    assert world.publisher.sent[0] == {"op": "advertise", "topic": "/base/cmd_vel", "type": name}
    # rosbridge unregisters a publisher 10 s after its guard is gone, and the base has to find the new one.
    assert len(world.publisher.sent) == 1 + ZEROS_AFTER_RECONNECT
    assert world.publisher.sent[1]["msg"]["header"] == {"frame_id": "base"}
    assert world.motion_file.driven is None
    await world.drive(0.1)
    world.controller.on_rosbridge_lost()
    assert counted(world) == {"fault": 2}


async def test_motion_nobody_knows_is_zeroed_by_the_settings(world):
    """A mark that cannot be read stands for the topics that have plain names, by a zero of whatever type they have."""
    world.motion_file.driven = []
    world.controller.resume()
    await world.pass_time(5)
    zero = {"op": "publish", "topic": "/cmd_vel", "msg": {}}
    assert world.publisher.sent == [zero] * ZEROS_AFTER_RECONNECT


async def test_a_last_zero_that_may_be_lost_is_sent_again(world):
    """The driver let go in the moment in which rosbridge crashed; its next zeros find no rosbridge."""
    await world.drive(0.5)
    world.publisher.read_until = world.now
    await world.pass_time(0.05)
    await world.drive(0.0)
    assert not world.controller.moving
    world.publisher.up = False
    world.controller.on_rosbridge_lost()
    world.publisher.up, world.publisher.sent = True, []
    world.controller.on_rosbridge_connected()
    await world.pass_time(5)
    assert world.publisher.speeds == [0.0] * ZEROS_AFTER_RECONNECT


@pytest.mark.parametrize("left_by_the_last_guard", [False, True])
async def test_a_stop_also_zeroes_what_an_earlier_driver_moved(world, left_by_the_last_guard):
    """A new driver makes room of what only had a name."""
    if left_by_the_last_guard:
        world.motion_file.driven = [Driven("/other/cmd_vel", "twist")]
        world.controller.resume()
    else:
        await world.drive(0.5, topic="/other/cmd_vel")
    await world.pass_time(5)
    world.publisher.read_until = world.now
    world.authorizer.lease(14, held=True)
    stamp = {"t_ms": world.now * 1000, "fence": 14}
    await world.drive(0.5, FakeSource(Authorization("drive", 14)), robotether=stamp)
    world.publisher.sent = []
    world.controller.stop()
    await world.pass_time(2)
    zeroed = [m["topic"] for m in world.publisher.sent if m["op"] == "publish"]
    assert sorted(zeroed) == ["/cmd_vel"] * 10 + ["/other/cmd_vel"] * 10


async def test_a_last_zero_that_was_read_is_not_sent_again(world):
    """Somebody else may move the robot meanwhile."""
    await world.drive(0.5)
    await world.drive(0.0)
    world.publisher.read_until = world.now
    world.publisher.sent = []
    world.controller.on_rosbridge_lost()
    await world.pass_time(0.6)
    assert world.publisher.speeds == []


async def test_a_stop_while_the_topic_is_announced_is_no_motion(world):
    """What was about to be sent is forgotten, also when it was taken up already."""
    await world.send(op="advertise", type="geometry_msgs/Twist")
    world.controller.on_rosbridge_lost()
    send = world.publisher.send

    async def stopped_meanwhile(data):
        world.controller.stop()
        return await send(data)

    world.publisher.send = stopped_meanwhile
    await world.drive(0.5)
    assert world.publisher.speeds == []
    assert not world.controller.moving


async def test_rosbridges_status_goes_to_the_driver(world):
    world.controller.on_rosbridge_message(b"nobody drives yet")
    await world.drive(0.5)
    world.controller.on_rosbridge_message(b"{}")
    assert world.source.notified == [b"{}"]
    world.controller.on_disconnected(world.source)
    world.controller.on_rosbridge_message(b"{}")
    assert world.source.notified == [b"{}"]


async def test_the_task_sleeps_until_something_is_due(world, spawn):
    world.controller.use(GuardConfig("ws://x", max_age_s=60, deadman_s=60))
    world.authorizer.on_agent_message(world.now + 60)
    spawn(world.controller.run())
    await asyncio.sleep(0.05)
    assert world.changes == 1
    await world.drive(0.5)
    world.publisher.full = True
    await world.drive(0.6)
    await asyncio.sleep(0.05)
    world.publisher.full = False
    world.controller.on_rosbridge_drained()
    await until("what waited is sent", lambda: world.publisher.speeds == [0.5, 0.6])
    world.controller.on_disconnected(world.source)
    await until("the zero is sent", lambda: len(world.publisher.sent) == 3)
    assert world.changes < 10


async def test_the_last_zeros_can_be_waited_for(world):
    """A guard that ends leaves no mark of a robot that stands, and that of one that moves."""
    await world.drive(0.5)
    world.controller.close()
    assert world.motion_file.read() is not None
    world.controller.halt()
    waits = asyncio.create_task(world.controller.until_at_rest())
    await world.pass_time(0.6)
    await asyncio.wait_for(waits, 1)
    world.controller.close()
    assert world.motion_file.read() is None


COMMANDS = st.lists(
    st.tuples(st.floats(-600, 5000), st.integers(11, 15), st.floats(0, 0.4), st.booleans()),
    max_size=20,
)


@given(COMMANDS)
def test_no_old_command_and_no_old_fence_passes(commands):
    async def scenario():
        world = World()
        given_at = {}
        for number, (age_ms, fence, pause_s, full) in enumerate(commands, 1):
            world.publisher.full = full
            given_at[float(number)] = (world.now - age_ms / 1000) if fence == 13 else -1e9
            stamp = {"t_ms": world.now * 1000 - age_ms, "fence": fence}
            before = len(world.publisher.speeds)
            await world.drive(float(number), robotether=stamp)
            await world.pass_time(pause_s, 0.05)
            for speed in world.publisher.speeds[before:]:
                # Sent at the latest now, at the earliest `pause_s` ago.
                assert speed == 0.0 or world.now - given_at[speed] <= 0.5 + pause_s + 0.05 + 1e-6

    asyncio.run(scenario())


async def test_a_command_that_reaches_nobody_is_refused_and_a_zero_is_not(world):
    await world.send(op="advertise", type="geometry_msgs/Twist")
    await world.drive(0.5)
    world.controller.on_unheard(frozenset({"/cmd_vel"}))
    await world.drive(0.6)
    assert world.publisher.speeds == [0.5]
    assert world.source.refused == [
        ("held", "cannot publish to /cmd_vel: nothing on the robot listens to /cmd_vel")
    ]
    await world.drive(0.0)
    assert world.publisher.speeds == [0.5, 0.0]
    world.controller.on_unheard(frozenset())
    await world.drive(0.7)
    assert world.publisher.speeds == [0.5, 0.0, 0.7]


async def test_the_driver_is_told_once_that_the_listeners_are_unknown(world):
    """A rosapi that has ended refuses nothing: the base may listen all the same."""
    await world.drive(0.5)
    for _ in range(2):
        world.controller.on_unheard(None)
    await world.drive(0.6)
    assert world.publisher.speeds == [0.5, 0.6]
    assert world.source.refused == []
    status = {"op": "status", "level": "error", "msg": LISTENERS_UNKNOWN}
    assert [json.loads(data) for data in world.source.notified] == [status]


async def test_what_rosapi_does_not_see_may_listen_on_ros_2(world):
    """A base of another release of ROS 2, or of plain DDS, has no node there."""
    await world.drive(0.5)
    world.controller.on_unheard(frozenset({"/cmd_vel"}), is_sure=False)
    await world.drive(0.6)
    assert world.publisher.speeds == [0.5, 0.6]
    assert world.source.refused == []
    status = {"op": "status", "level": "error", "msg": f"{UNHEARD} /cmd_vel"}
    assert [json.loads(data) for data in world.source.notified] == [status]


async def test_a_moving_robot_that_nothing_listens_for_any_more_gets_its_zeros(world):
    await world.drive(0.5)
    world.controller.on_unheard(frozenset({"/cmd_vel"}))
    for _ in range(10):
        await world.drive(0.5)
        await world.pass_time(0.1)
    assert world.publisher.speeds == [0.5] + [0.0] * ZEROS


async def test_a_topic_that_ros_has_forgotten_is_advertised_anew(world):
    advertise = {"op": "advertise", "topic": "/cmd_vel", "type": "geometry_msgs/Twist"}
    await world.send(op="advertise", type="geometry_msgs/Twist")
    assert world.controller.driven_now() == []
    await world.pass_time(REGISTERED_WITHIN_S + 0.1)
    assert world.controller.driven_now() == ["/cmd_vel"]
    world.controller.on_unregistered("/cmd_vel")
    await world.pass_time(UNREGISTERED_AFTER_S - 0.1)
    await world.drive(0.5)
    assert world.publisher.sent == [advertise, {"op": "unadvertise", "topic": "/cmd_vel"}]
    assert world.source.kinds == ["held"]
    await world.pass_time(0.2)
    assert world.publisher.sent[-1] == advertise
    await world.drive(0.5)
    assert world.publisher.speeds == [0.5]


async def test_a_stop_reaches_a_topic_that_is_to_be_forgotten(world):
    await world.send(op="advertise", type="geometry_msgs/Twist")
    await world.drive(0.5)
    await world.drive(0.0)
    world.controller.on_unregistered("/cmd_vel")
    await world.pass_time(0.1)
    world.controller.stop()
    await world.pass_time(1)
    assert world.publisher.speeds == [0.5, 0.0] + [0.0] * ZEROS


async def test_a_topic_in_motion_is_not_withdrawn(world):
    await world.send(op="advertise", type="geometry_msgs/Twist")
    await world.drive(0.5)
    world.controller.on_unregistered("/cmd_vel")
    await world.pass_time(0.1)
    assert [m["op"] for m in world.publisher.sent] == ["advertise", "publish"]
