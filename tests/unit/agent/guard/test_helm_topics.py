"""Which topics the helm takes, by type and in number, with a line and a clock of the tests."""

from __future__ import annotations

import asyncio

import pytest
from helm_world import FakeSource, World
from hypothesis import given
from hypothesis import strategies as st
from robotether_agent.guard.authority import Admission
from robotether_agent.guard.topics import MOST_TOPICS


async def test_a_topic_is_advertised_on_the_drive_line(world: World) -> None:
    """Once, without a latch, and again to the next rosbridge, before any command."""
    await world.send(op="advertise", type="geometry_msgs/Twist", latch=True)
    await world.send(op="advertise", type="geometry_msgs/Twist")
    advertise = {"op": "advertise", "topic": "/cmd_vel", "type": "geometry_msgs/Twist"}
    assert world.line.sent == [advertise]
    world.helm.line_lost()
    world.helm.line_up()
    await world.drive(0.5)
    assert world.line.sent[1] == advertise
    assert world.line.sent[2]["op"] == "publish"


@pytest.mark.parametrize(
    "name", [None, 3, "std_msgs/String", "geometry_msgs/TwistWithCovariance", "Twist"]
)
async def test_other_types_are_no_drive_types(world: World, name: object) -> None:
    """The guard could not stop what moves by them."""
    await world.send(op="advertise", type=name)
    assert world.line.sent == []
    assert world.source.kinds == ["shape"]


STAMPED = {"twist": {"linear": {"x": 0.0}}}


async def test_standing_still_in_another_type_is_refused(world: World) -> None:
    """The robot would not take it and drive on; so the deadman still runs, and a stop is of the type that moved it."""
    await world.drive(0.5)
    await world.drive(0.0, msg=STAMPED)
    assert world.source.kinds == ["shape"]
    assert world.helm.moving
    await world.pass_time(0.6)
    assert world.line.speeds[:2] == [0.5, 0.0]


async def test_a_stop_reaches_a_robot_whose_driver_changed_the_type(world: World) -> None:
    """Neither a message nor an advertisement turns the guard's zeros into something that rosbridge refuses."""
    await world.drive(0.5)
    await world.send(op="advertise", type="geometry_msgs/TwistStamped")
    await world.drive(0.7, msg=STAMPED)
    world.helm.stop()
    await world.pass_time(0.1)
    assert world.source.kinds == ["shape", "shape"]
    assert world.line.sent[-1] == world.line.sent[-2]
    assert world.line.speeds[-1] == 0.0


async def test_another_type_is_taken_when_the_robot_stands(world: World) -> None:
    """A client that guessed wrong may correct itself."""
    await world.drive(0.5)
    await world.pass_time(1.2)
    await world.drive(0.5, msg=STAMPED)
    assert world.source.kinds == []
    assert world.line.sent[-1]["msg"]["twist"]


async def test_the_number_of_topics_is_bounded(world: World) -> None:
    """Operators choose their names."""
    for number in range(MOST_TOPICS + 5):
        await world.drive(0.1, topic=f"/r{number}/cmd_vel")
    assert len(world.line.sent) == MOST_TOPICS
    assert world.source.kinds == ["shape"] * 5


async def invent(world: World, count: int, speed: float = 0.0) -> None:
    """Let the driver publish to so many topics that nobody listens to."""
    for number in range(count):
        world.line.read_until = world.now = world.now + 0.001
        world.authority.heard(world.now)
        await world.drive(speed, topic=f"/i{number}/cmd_vel")


def names(world: World, operation: str) -> list[str]:
    """The topics of such messages on the line."""
    return [m["topic"] for m in world.line.sent if m["op"] == operation]


async def test_invented_topics_do_not_keep_the_real_one_out(world: World) -> None:
    """Those that stand make room, the oldest first, and rosbridge is told."""
    await invent(world, MOST_TOPICS + 2)
    world.line.read_until = world.now
    await world.drive(0.5, topic="/real/cmd_vel")
    await world.helm.step()
    assert world.source.refused == []
    assert sorted(names(world, "unadvertise")) == [f"/i{n}/cmd_vel" for n in range(3)]
    assert names(world, "publish")[-1] == "/real/cmd_vel"


async def test_what_moves_or_is_zeroed_keeps_its_place(world: World) -> None:
    """Also a stop that rosbridge may not have read; and a named topic needs nobody's place."""
    await invent(world, MOST_TOPICS, speed=0.1)
    world.helm.gone(world.source)
    await world.helm.step()
    world.line.read_until = world.now
    await world.drive(0.1, topic="/real/cmd_vel")
    await world.drive(0.1)
    assert world.source.kinds == ["shape"]
    assert names(world, "publish")[-1] == "/cmd_vel"
    await world.pass_time(2)
    await world.drive(0.1, topic="/real/cmd_vel")
    assert world.source.kinds == ["shape"] * 2
    world.line.read_until = world.now
    await world.drive(0.1, topic="/real/cmd_vel")
    assert names(world, "publish")[-1] == "/real/cmd_vel"


async def test_a_new_driver_finds_free_places(world: World) -> None:
    """Of topics that were only named; whoever may not drive gets nobody's place."""
    await invent(world, MOST_TOPICS)
    world.line.read_until = world.now
    direct, new = FakeSource(Admission("direct")), FakeSource(Admission("drive", 14))
    advertise = {"op": "advertise", "topic": "/x/cmd_vel", "type": "geometry_msgs/Twist"}
    await world.send(direct, **advertise)
    assert direct.kinds == ["shape"]
    world.authority.lease(14, held=True)
    await world.send(new, **advertise)
    await world.helm.step()
    assert new.refused == []
    assert len(names(world, "unadvertise")) == MOST_TOPICS
    await world.send(direct, **{**advertise, "topic": "/y/cmd_vel"})
    assert direct.kinds == ["shape"]


async def test_a_topic_that_made_room_is_zeroed_by_its_type(world: World) -> None:
    """A rosbridge that has just started knows no types: it would refuse a zero that has not been advertised."""
    advertise = {"op": "advertise", "topic": "/real/cmd_vel", "type": "geometry_msgs/Twist"}
    await world.send(**advertise)
    await invent(world, MOST_TOPICS)
    world.line.read_until = world.now
    await world.helm.step()
    assert names(world, "unadvertise") == ["/real/cmd_vel"]
    await world.drive(0.5, topic="/real/cmd_vel")
    world.helm.line_lost()
    world.line.sent.clear()
    world.helm.line_up()
    await world.helm.step()
    assert next(m for m in world.line.sent if m["topic"] == "/real/cmd_vel") == advertise
    assert world.line.sent[-1]["op"] == "publish"


async def test_an_empty_message_stops_also_a_topic_that_made_room(world: World) -> None:
    """Rosbridge reads it as zero of the advertised type."""
    await world.send(op="advertise", topic="/real/cmd_vel", type="geometry_msgs/Twist")
    await invent(world, MOST_TOPICS)
    world.line.read_until = world.now
    await world.drive(0.5, topic="/real/cmd_vel")
    await world.drive(0.0, topic="/real/cmd_vel", msg={})
    assert world.source.refused == []
    assert world.line.speeds[-2:] == [0.5, 0.0]


async def test_a_broken_command_takes_nobodys_place(world: World) -> None:
    """It is refused before."""
    await invent(world, MOST_TOPICS)
    world.line.read_until = world.now
    await world.drive(0.5, topic="/real/cmd_vel", msg={"linear": {"x": None}})
    await world.helm.step()
    assert names(world, "unadvertise") == []


STEPS = st.lists(
    st.tuples(
        st.integers(0, 4 * MOST_TOPICS),
        st.booleans(),
        st.sampled_from([0.0, 0.0, 0.0, 0.1, 0.6]),
        st.booleans(),
    ),
    min_size=MOST_TOPICS + 4,
    max_size=60,
)


@given(STEPS)
def test_every_motion_ends_with_its_zero(steps: list[tuple[int, bool, float, bool]]) -> None:
    """However many names there are, and whichever of them made room."""

    async def scenario() -> None:
        world = World()
        for number, moves, pause_s, read in steps:
            await world.drive(float(moves), topic=f"/i{number}/cmd_vel")
            await world.pass_time(pause_s, 0.1)
            world.line.read_until = world.now if read else world.line.read_until
        await world.pass_time(3, 0.1)
        last = {m["topic"]: m["msg"]["linear"]["x"] for m in world.line.sent if "msg" in m}
        assert set(last.values()) <= {0.0}
        assert world.mark.read() is None

    asyncio.run(scenario())
