"""What the helm knows of each drive topic."""

from __future__ import annotations

import pytest
from robotether_agent.guard.authority import Admission
from robotether_agent.guard.commands import Command
from robotether_agent.guard.marks import Driven
from robotether_agent.guard.messages import MessageId
from robotether_agent.guard.refused import Kind, Refused
from robotether_agent.guard.topics import MOST_TOPICS, MOST_TYPES, Topic, Topics, Waiting


class Nobody:
    """A source that hears nothing."""

    admission = Admission("observe")

    def refuse(self, kind: Kind, text: str, message_id: MessageId) -> None:
        """Drop it."""

    def tell(self, data: bytes) -> None:
        """Drop it."""


def stays(_: Topic) -> bool:
    """None may go."""
    return False


def goes(_: Topic) -> bool:
    """Each may go."""
    return True


def test_a_topic_that_was_driven_can_be_zeroed_later() -> None:
    """With its shape, type and frame; one that was only advertised cannot."""
    topic = Topic("/cmd_vel", "geometry_msgs/TwistStamped")
    assert topic.driven is None
    assert topic.declared == "twist_stamped"
    topic.sent = Command("twist_stamped", header={"frame_id": "base"})
    assert topic.driven == Driven("/cmd_vel", "twist_stamped", "geometry_msgs/TwistStamped", "base")


def test_their_number_is_bounded() -> None:
    """Those that are known stay."""
    topics = Topics()
    for number in range(MOST_TOPICS):
        topics.place(f"/t{number}", 1.0, stays)
    with pytest.raises(Refused):
        topics.place("/one_more", 2.0, stays)
    assert topics.place("/t3", 3.0, stays).name == "/t3"
    assert len(list(topics)) == MOST_TOPICS


def test_the_one_that_was_used_the_longest_ago_makes_room() -> None:
    """Of those that may go; rosbridge is told of it if it knows it."""
    topics = Topics()
    for number in range(MOST_TOPICS):
        topics.place(f"/t{number}", float(number), stays).announced = number == 3
    topics.place("/t2", 50.0, stays)
    zeroed = topics.find("/t1")
    assert zeroed is not None
    zeroed.sent_at = 60.0
    topics.place("/new", 70.0, lambda topic: topic.name != "/t0")
    assert "/t3" not in topics
    assert all(name in topics for name in ("/t0", "/t1", "/t2", "/new"))
    assert topics.parting
    assert topics.next_parting() == "/t3"
    assert not topics.parting


def test_named_topics_have_places_of_their_own() -> None:
    """However many others there are, and they never make room."""
    topics = Topics()
    topics.named = frozenset({"/cmd_vel", "/base/cmd_vel"})
    topics.place("/cmd_vel", 0.0, goes)
    for number in range(3 * MOST_TOPICS):
        topics.place(f"/t{number}", 1.0, goes)
    topics.free_unmoved(goes)
    assert [topic.name for topic in topics] == ["/cmd_vel"]
    for number in range(MOST_TOPICS):
        topics.place(f"/t{number}", 1.0, stays)
    assert topics.place("/base/cmd_vel", 2.0, stays).name == "/base/cmd_vel"


def test_a_topic_that_comes_back_is_not_unadvertised() -> None:
    """It would be, after its next command."""
    topics = Topics()
    topics.place("/t", 0.0, goes).announced = True
    topics.free_unmoved(goes)
    assert topics.parting
    topics.place("/t", 1.0, goes)
    assert not topics.parting


def advertised(topics: Topics, names: list[str]) -> None:
    """Let these topics be advertised, one after the other."""
    for at, name in enumerate(names):
        topics.place(name, float(at), goes).type = "geometry_msgs/Twist"


def test_the_type_of_a_topic_that_made_room_comes_back_with_it() -> None:
    """Its client advertised it once; of more topics than may be kept, those count that went last."""
    topics = Topics()
    invented = [f"/t{number}" for number in range(MOST_TOPICS + MOST_TYPES)]
    advertised(topics, ["/first", *invented])
    assert topics.place("/t1", 200.0, goes).type == "geometry_msgs/Twist"
    assert topics.place("/first", 201.0, goes).type == ""


def test_a_new_driver_finds_no_types_of_topics_that_made_room() -> None:
    """Else the one before could make rosbridge refuse what the new one sends."""
    topics = Topics()
    advertised(topics, ["/first", *(f"/t{number}" for number in range(MOST_TOPICS))])
    topics.free_unmoved(goes)
    assert {topics.place(name, 50.0, goes).type for name in ("/first", "/t1")} == {""}


def test_topics_that_moved_keep_their_places_for_a_new_driver() -> None:
    """Somebody really drives by them."""
    topics = Topics()
    topics.place("/t", 0.0, goes).moved = True
    topics.place("/other", 0.0, goes)
    topics.free_unmoved(goes)
    assert [topic.name for topic in topics] == ["/t"]


def test_what_a_source_sent_goes_with_it() -> None:
    """What waits is forgotten, and no reference to it stays."""
    topics, gone, other = Topics(), Nobody(), Nobody()
    for name, source in (("/a", gone), ("/b", other)):
        topic = topics.add(name)
        topic.source, topic.waiting = source, Waiting(Command("twist"), source, 0.0, None)
    assert topics.of(lambda source: source is gone) == ["/a"]
    topics.forget_waiting(lambda source: source is gone)
    topics.forget_source(gone)
    assert [(t.source, t.waiting is None) for t in topics] == [(None, True), (other, False)]
