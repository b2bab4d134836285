"""Topics exist while somebody uses them, and have one type."""

import logging

import pytest
from sim_robot.bus import Bus, Node, TopicMessage, full_name
from sim_robot.messages import MessageTypes
from sim_robot.problems import NameInvalid, TopicNotEstablished, TypeConflict, TypeUnknown

STRING = "std_msgs/String"


@pytest.fixture
def bus() -> Bus:
    """An empty bus."""
    return Bus(MessageTypes(2))


def test_message_reaches_all_subscribers(bus: Bus) -> None:
    """Two nodes of one name get the message each."""
    seen: list[TopicMessage] = []
    bus.subscribe("/a", STRING, Node("/n"), seen.append)
    bus.subscribe("/a", None, Node("/n"), seen.append)
    bus.publish("/a", {"data": "x"})
    assert [message.values for message in seen] == [{"data": "x"}] * 2
    assert bus.subscriber_names("/a") == ["/n"]


def test_topic_ends_with_its_last_user(bus: Bus) -> None:
    """After the last unadvertise and unsubscribe the topic may come back with another type."""
    one, other = Node("/one"), Node("/other")
    bus.advertise("/a", STRING, one)
    bus.subscribe("/a", None, other, lambda _: None)
    bus.unadvertise("/a", one)
    assert bus.topics() == {"/a": STRING}
    bus.unsubscribe("/a", other)
    assert bus.topics() == {}
    bus.advertise("/a", "std_msgs/Bool", one)


def test_latched_message_is_kept_while_the_topic_is_there(bus: Bus) -> None:
    """The last latched message waits for those who come later; one that is not latched does not."""
    bus.advertise("/a", STRING, one := Node("/one"))
    assert bus.latched("/a") is None
    bus.publish("/a", {"data": "kept"}, latched=True)
    bus.publish("/a", {"data": "passing"})
    assert (kept := bus.latched("/a")) is not None
    assert kept.values == {"data": "kept"}
    bus.unadvertise("/a", one)
    assert bus.latched("/a") is None


def test_other_type_is_refused(bus: Bus) -> None:
    """The second type of a topic is a conflict that names both."""
    bus.advertise("/a", STRING, Node("/n"))
    with pytest.raises(TypeConflict, match=r"std_msgs/Bool.*std_msgs/msg/String"):
        bus.subscribe("/a", "std_msgs/Bool", Node("/n"), lambda _: None)


def test_type_must_be_known(bus: Bus) -> None:
    """Without a type a topic must exist, and a type must be one."""
    with pytest.raises(TopicNotEstablished, match="/a"):
        bus.subscribe("/a", None, Node("/n"), lambda _: None)
    with pytest.raises(TypeUnknown):
        bus.advertise("/a", "no/Type", Node("/n"))
    assert bus.topics() == {}


def test_failing_subscriber_hurts_no_other(bus: Bus, caplog: pytest.LogCaptureFixture) -> None:
    """A callback that raises is logged, and the next one gets its message."""
    seen: list[TopicMessage] = []
    bus.subscribe("/a", STRING, Node("/bad"), lambda _: {}["missing"])
    bus.subscribe("/a", STRING, Node("/good"), seen.append)
    with caplog.at_level(logging.ERROR):
        bus.publish("/a", {"data": ""})
    assert len(seen) == 1
    assert "KeyError" in caplog.text


def test_relative_name_becomes_absolute() -> None:
    """cmd_vel is /cmd_vel."""
    assert full_name("cmd_vel") == full_name("/cmd_vel") == "/cmd_vel"


@pytest.mark.parametrize(
    "name", ["", "/", "/a b", "/1a", "/a//b", "/a/", "/é", "/a\n", "/" + "a" * 300]
)
def test_bad_name_is_refused(name: str) -> None:
    """What ROS would not take as a name is refused."""
    with pytest.raises(NameInvalid):
        full_name(name)
