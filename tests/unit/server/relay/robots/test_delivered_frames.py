"""Which frames a user was sent, and what the robot calls them."""

import pytest
from robotether_common.guard import MAX_FRAMES, MAX_SEEN_S
from robotether_server.relay.robots.delivered_frames import DeliveredFrames, NamedFrame
from validators import Clock


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def delivered(clock):
    return DeliveredFrames(clock)


def test_a_frame_is_forgotten(delivered, clock):
    delivered.note(1, "/a", 5, 905)
    clock.now += MAX_SEEN_S
    assert delivered.robots(1, NamedFrame("/a", 5)).frame == 905
    clock.now += 0.1
    assert delivered.robots(1, NamedFrame("/a", 5)).frame is None


def test_a_number_that_two_feeds_gave_is_unknown(delivered, clock):
    """Else a driver could seem to see the newer of the two frames."""
    for robot_sequence in (905, 905, 7):
        delivered.note(1, "/a", 5, robot_sequence)
    assert delivered.robots(1, NamedFrame("/a", 5)).frame is None
    clock.now += MAX_SEEN_S + 0.1
    delivered.note(1, "/a", 5, 7)
    assert delivered.robots(1, NamedFrame("/a", 5)).frame == 7


def test_memory_is_bounded(delivered, clock):
    for number in range(MAX_FRAMES + 10):
        delivered.note(1, "/a", number, number)
    assert delivered.robots(1, NamedFrame("/a", 9)).frame is None
    assert delivered.robots(1, NamedFrame("/a", 10)).frame == 10
    clock.now += MAX_SEEN_S + 1
    delivered.note(2, "/a", 1, 1)
    assert list(delivered._frames) == [(2, "/a")]
