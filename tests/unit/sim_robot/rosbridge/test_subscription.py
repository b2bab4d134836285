"""Several subscribe calls to one topic share one delivery that satisfies all."""

from sim_robot.bus import TopicMessage
from sim_robot.rosbridge.delivery import Delivery
from sim_robot.rosbridge.subscription import Subscription, Wish


class RecordedDelivery(Delivery):
    """Keeps how it was configured last."""

    configured: tuple[int, int] | None = None

    def __init__(self) -> None:
        super().__init__(lambda _message: None)

    def configure(self, throttle_ms: int, queue_length: int) -> None:
        self.configured = (throttle_ms, queue_length)


async def test_fastest_wish_wins() -> None:
    """The lowest throttle and queue count, and come back when that wish goes."""
    delivery = RecordedDelivery()
    subscription = Subscription(delivery)
    subscription.add("slow", Wish(500, 10, "none"))
    subscription.add("fast", Wish(100, 2, "none"))
    assert delivery.configured == (100, 2)
    subscription.remove("fast")
    assert delivery.configured == (500, 10)


async def test_cbor_wins() -> None:
    """One wish for CBOR makes all messages CBOR, as in the real one."""
    subscription = Subscription(RecordedDelivery())
    subscription.add("a", Wish(0, 0, "none"))
    assert subscription.compression == "none"
    subscription.add("b", Wish(0, 0, "cbor"))
    assert subscription.compression == "cbor"


async def test_same_id_replaces_and_no_id_removes_all() -> None:
    """An id stands for one wish; without one everything goes."""
    subscription = Subscription(RecordedDelivery())
    for _ in range(3):
        subscription.add("a", Wish(0, 0, "none"))
    subscription.add(None, Wish(0, 0, "none"))
    assert len(subscription) == 2
    subscription.remove("unknown")
    assert len(subscription) == 2
    subscription.remove(None)
    assert len(subscription) == 0


async def test_messages_pass_to_the_delivery() -> None:
    """What is offered reaches the delivery."""
    sent: list[TopicMessage] = []
    subscription = Subscription(Delivery(sent.append))
    subscription.offer(TopicMessage("/a", "std_msgs/Empty", {}))
    assert len(sent) == 1
