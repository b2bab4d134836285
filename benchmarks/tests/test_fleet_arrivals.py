"""Which robot got its message, and what counts as wrong."""

from __future__ import annotations

import pytest
from paper.fleet_arrivals import Arrivals

SECOND_NS = 1_000_000_000


@pytest.fixture
def arrivals() -> Arrivals:
    """Two robots, from second 10 on."""
    return Arrivals(["one", "two"], "start-7", 10 * SECOND_NS)


def test_a_robot_gets_the_text_that_was_sent_to_it(arrivals):
    """The first one counts, in seconds since the order; a second is counted beside it."""
    first, second = arrivals.text("one"), arrivals.text("one")
    arrivals.got("one", first, 12 * SECOND_NS)
    arrivals.got("one", second, 13 * SECOND_NS)
    values = arrivals.values()
    assert values["message_s"] == [2.0, None]
    assert (values["published"], values["received"], values["wrong"]) == (2, 2, 0)
    assert arrivals.has_arrived("one")
    assert not arrivals.has_arrived("two")


@pytest.mark.parametrize(
    ("robot", "text"),
    [
        ("two", "one start-7 1"),
        ("one", "one start-6 1"),
        ("one", "one start-7 2"),
        ("one", "one start-7"),
        ("one", ""),
        ("three", "three start-7 1"),
    ],
)
def test_anything_else_is_wrong(arrivals, robot, text):
    """Another robot's, another run's, and what nobody has sent: none of it is an arrival."""
    arrivals.text("one")
    arrivals.got(robot, text, 12 * SECOND_NS)
    values = arrivals.values()
    assert (values["wrong"], values["received"]) == (1, 0)
    assert values["wrong_texts"] == [f"{robot} got {text!r}"]


def test_online_and_the_servers_first_word_count_once(arrivals):
    """A robot that comes and goes was first online when it came; a robot of others is nobody's."""
    for second in (11, 15):
        arrivals.is_online("two", second * SECOND_NS)
        arrivals.server_answers(second * SECOND_NS)
    arrivals.is_online("sim1", 11 * SECOND_NS)
    values = arrivals.values()
    assert values["online_s"] == [None, 1.0]
    assert values["server_s"] == 1.0
