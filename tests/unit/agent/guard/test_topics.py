"""What the drive controller knows of each drive topic, and which it takes, with a line and a clock of the tests."""

import asyncio

from controller_world import FakeSource, World
from hypothesis import given, settings
from hypothesis import strategies as st
from robotether_agent.guard.topics import MAX_TOPICS, MAX_TYPES, Authorization, Topics


def stays(_):
    return False


def goes(_):
    return True


def test_the_next_rosbridge_knows_no_topic():
    """It must be told of none that parted, and anew of those that stay."""
    topics = Topics()
    topics.ensure("/stays", 0.0, stays).announced = True
    topics.ensure("/goes", 0.0, goes).announced = True
    topics.free_unmoved(lambda topic: topic.name == "/goes")
    topics.on_rosbridge_lost()
    assert not topics.parting
    assert [(topic.name, topic.announced) for topic in topics] == [("/stays", False)]


def test_named_topics_have_places_of_their_own():
    topics = Topics()
    topics.named = frozenset({"/cmd_vel"})
    topics.ensure("/cmd_vel", 0.0, goes)
    for number in range(MAX_TOPICS + 1):
        topics.ensure(f"/t{number}", 1.0, goes)
    topics.free_unmoved(goes)
    assert [topic.name for topic in topics] == ["/cmd_vel"]


def test_a_topic_that_comes_back_is_not_unadvertised():
    topics = Topics()
    topics.ensure("/t", 0.0, goes).announced = True
    topics.free_unmoved(goes)
    assert topics.parting
    topics.ensure("/t", 1.0, goes)
    assert not topics.parting


def advertised(topics, names):
    for at, name in enumerate(names):
        topics.ensure(name, float(at), goes).type = "geometry_msgs/Twist"


def test_the_type_of_a_topic_that_made_room_comes_back_with_it():
    """Its client advertised it once; if more topics come than may be kept, the last ones to go count."""
    topics = Topics()
    invented = [f"/t{number}" for number in range(MAX_TOPICS + MAX_TYPES)]
    advertised(topics, ["/first", *invented])
    assert topics.ensure("/t1", 200.0, goes).type == "geometry_msgs/Twist"
    assert topics.ensure("/first", 201.0, goes).type == ""


def test_a_new_driver_finds_no_types_of_topics_that_made_room():
    """Else the one before could make rosbridge refuse what the new one sends."""
    topics = Topics()
    advertised(topics, ["/first", *(f"/t{number}" for number in range(MAX_TOPICS))])
    topics.free_unmoved(goes)
    assert {topics.ensure(name, 50.0, goes).type for name in ("/first", "/t1")} == {""}


def test_a_new_driver_frees_no_topic_that_moved_or_must_stay():
    """A zero may be owed to one that never moved, too."""
    topics = Topics()
    topics.ensure("/moved", 0.0, goes).moved = True
    topics.ensure("/stays", 0.0, goes)
    topics.free_unmoved(lambda topic: topic.name != "/stays")
    assert [topic.name for topic in topics] == ["/moved", "/stays"]


async def test_a_topic_is_advertised_on_the_publisher(world):
    await world.send(op="advertise", type="geometry_msgs/Twist", latch=True)
    await world.send(op="advertise", type="geometry_msgs/Twist")
    advertise = {"op": "advertise", "topic": "/cmd_vel", "type": "geometry_msgs/Twist"}
    await world.send(op="unadvertise")
    assert world.publisher.sent == [advertise]
    world.controller.on_rosbridge_lost()
    world.controller.on_rosbridge_connected()
    await world.drive(0.5)
    assert world.publisher.sent[1] == advertise
    assert world.publisher.sent[2]["op"] == "publish"


STAMPED = {"twist": {"linear": {"x": 0.0}}}


async def test_a_stop_reaches_a_robot_whose_driver_changed_the_type(world):
    """Neither a message nor an advertisement turns the guard's zeros into something that rosbridge refuses."""
    await world.drive(0.5)
    await world.send(op="advertise", type="geometry_msgs/Twist")
    await world.send(op="advertise", type="geometry_msgs/TwistStamped")
    await world.drive(0.7, msg=STAMPED)
    world.controller.stop()
    await world.pass_time(0.1)
    assert world.source.kinds == ["shape", "shape"]
    assert world.publisher.sent[-1] == world.publisher.sent[-2]
    assert world.publisher.speeds[-1] == 0.0


async def test_another_type_is_taken_when_the_robot_stands(world):
    await world.drive(0.5)
    await world.pass_time(1.2)
    await world.drive(0.5, msg=STAMPED)
    assert world.source.kinds == []
    assert world.publisher.sent[-1]["msg"]["twist"]


async def invent(world, count, speed=0.0):
    for number in range(count):
        world.publisher.read_until = world.now = world.now + 0.001
        world.authorizer.on_agent_message(world.now)
        await world.drive(speed, topic=f"/i{number}/cmd_vel")


def names(world, operation):
    return [m["topic"] for m in world.publisher.sent if m["op"] == operation]


async def test_invented_topics_do_not_keep_the_real_one_out(world):
    """Those that stand make room, the oldest first, and rosbridge is told."""
    await invent(world, MAX_TOPICS + 2)
    world.publisher.read_until = world.now
    await world.drive(0.5, topic="/real/cmd_vel")
    await world.controller.step()
    assert world.source.refused == []
    assert sorted(names(world, "unadvertise")) == [f"/i{n}/cmd_vel" for n in range(3)]
    assert names(world, "publish")[-1] == "/real/cmd_vel"


async def test_what_moves_or_is_zeroed_keeps_its_place(world):
    """Also a stop that rosbridge may not have read; and a named topic needs nobody's place."""
    await invent(world, MAX_TOPICS, speed=0.1)
    world.controller.on_disconnected(world.source)
    await world.controller.step()
    world.publisher.read_until = world.now
    await world.drive(0.1, topic="/real/cmd_vel")
    await world.drive(0.1)
    assert world.source.kinds == ["shape"]
    assert names(world, "publish")[-1] == "/cmd_vel"
    await world.pass_time(2)
    await world.drive(0.1, topic="/real/cmd_vel")
    assert world.source.kinds == ["shape"] * 2
    world.publisher.read_until = world.now
    await world.drive(0.1, topic="/real/cmd_vel")
    assert names(world, "publish")[-1] == "/real/cmd_vel"


async def test_a_new_driver_finds_free_places(world):
    """Of topics that were only named; whoever may not drive gets nobody's place."""
    await invent(world, MAX_TOPICS)
    world.publisher.read_until = world.now
    direct, new = FakeSource(Authorization("direct")), FakeSource(Authorization("drive", 14))
    advertise = {"op": "advertise", "topic": "/x/cmd_vel", "type": "geometry_msgs/Twist"}
    await world.send(direct, **advertise)
    assert direct.kinds == ["shape"]
    world.authorizer.lease(14, held=True)
    await world.send(new, **advertise)
    await world.controller.step()
    assert new.refused == []
    assert len(names(world, "unadvertise")) == MAX_TOPICS
    await world.send(direct, **{**advertise, "topic": "/y/cmd_vel"})
    assert direct.kinds == ["shape"]


async def test_an_empty_message_stops_also_a_topic_that_made_room(world):
    """Rosbridge reads it as zero of the advertised type."""
    await world.send(op="advertise", topic="/real/cmd_vel", type="geometry_msgs/Twist")
    await invent(world, MAX_TOPICS)
    world.publisher.read_until = world.now
    await world.drive(0.5, topic="/real/cmd_vel")
    await world.drive(0.0, topic="/real/cmd_vel", msg={})
    assert world.source.refused == []
    assert world.publisher.speeds[-2:] == [0.5, 0.0]


async def test_a_broken_command_takes_nobodys_place(world):
    await invent(world, MAX_TOPICS)
    world.publisher.read_until = world.now
    await world.drive(0.5, topic="/real/cmd_vel", msg={"linear": {"x": None}})
    await world.controller.step()
    assert names(world, "unadvertise") == []


STEPS = st.lists(
    st.tuples(
        st.integers(0, 4 * MAX_TOPICS),
        st.booleans(),
        st.sampled_from([0.0, 0.0, 0.0, 0.1, 0.6]),
        st.booleans(),
    ),
    min_size=MAX_TOPICS + 4,
    max_size=60,
)


@settings(max_examples=40)
@given(STEPS)
def test_every_motion_ends_with_its_zero(steps):
    async def scenario():
        world = World()
        for number, moves, pause_s, read in steps:
            await world.drive(float(moves), topic=f"/i{number}/cmd_vel")
            await world.pass_time(pause_s, 0.1)
            world.publisher.read_until = world.now if read else world.publisher.read_until
        await world.pass_time(3, 0.1)
        last = {m["topic"]: m["msg"]["linear"]["x"] for m in world.publisher.sent if "msg" in m}
        assert set(last.values()) <= {0.0}
        assert world.motion_file.read() is None

    asyncio.run(scenario())
