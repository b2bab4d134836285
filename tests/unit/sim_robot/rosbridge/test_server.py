"""Rosbridge over real sockets: programs, cuts and clients that misbehave."""

import itertools
import time

from sim_client import until
from sim_robot.graph import TopicMessage
from sim_robot.rosbridge.client import ThrottledQueue


class Sink:
    """A delivery and what it sent, with the moments."""

    def __init__(self, throttle_ms: int, queue_length: int) -> None:
        self.sent: list[int] = []
        self.moments: list[float] = []
        self.delivery = ThrottledQueue(self._take)
        self.delivery.configure(throttle_ms, queue_length)

    def offer(self, *numbers: int) -> None:
        """Offer messages at once."""
        for number in numbers:
            self.delivery.offer(TopicMessage("/a", "std_msgs/Int32", {"data": number}))

    def _take(self, message: TopicMessage) -> None:
        self.sent.append(message.values["data"])
        self.moments.append(time.monotonic())


async def test_queue_without_throttle_goes_out_at_once() -> None:
    """A queue holds nothing back by itself, as roslib's default of queue_length 1 needs."""
    sink = Sink(0, 1)
    sink.offer(*range(100))
    assert sink.sent == list(range(100))


async def test_throttle_leaves_out() -> None:
    """Within the throttle time only the first message goes out; after it the next one."""
    sink = Sink(60, 0)
    sink.offer(1, 2, 3)
    assert sink.sent == [1]
    first = time.monotonic()
    await until("throttle time over", lambda: time.monotonic() - first > 0.07)
    sink.offer(4, 5)
    assert sink.sent == [1, 4]


async def test_queue_delays_and_drops_the_oldest() -> None:
    """With a queue of 2, the newest two wait and go out one a throttle time."""
    sink = Sink(40, 2)
    sink.offer(1, 2, 3, 4, 5)
    await until("queue sent", lambda: len(sink.sent) == 3)
    assert sink.sent == [1, 4, 5]
    gaps = [b - a for a, b in itertools.pairwise(sink.moments)]
    assert min(gaps) > 0.035
