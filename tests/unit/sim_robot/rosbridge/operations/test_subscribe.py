"""subscribe and unsubscribe."""

from typing import Any

import cbor2
import pytest
from sim_client import DirectClient


async def publish(client: DirectClient, *texts: str) -> list[str]:
    """Publish on /a and give what came back."""
    for text in texts:
        client.graph.bus.publish("/a", {"data": text})
    return [message["msg"]["data"] for message in await client.received()]


@pytest.fixture
async def topic(client: DirectClient) -> DirectClient:
    """A client and a topic /a that stays."""
    await DirectClient(client.graph).send(op="advertise", topic="/a", type="std_msgs/String")
    return client


async def test_type_is_inferred(topic: DirectClient) -> None:
    """A topic that exists needs no type."""
    assert await topic.send(op="subscribe", topic="/a") == []
    assert await publish(topic, "x", "y") == ["x", "y"]


async def test_subscribing_twice_delivers_once(topic: DirectClient) -> None:
    """Two ids of one client get one copy of each message."""
    for name in ("one", "two"):
        await topic.send(op="subscribe", topic="/a", id=name)
    assert await publish(topic, "x") == ["x"]


async def test_unsubscribe_by_id_and_for_all(topic: DirectClient) -> None:
    """An id ends one subscription; without one all end."""
    for name in ("one", "two", "three"):
        await topic.send(op="subscribe", topic="/a", id=name)
    await topic.send(op="unsubscribe", topic="/a", id="one")
    assert await publish(topic, "x") == ["x"]
    assert await topic.send(op="unsubscribe", topic="/a") == []
    assert await publish(topic, "y") == []
    assert topic.graph.bus.subscriber_names("/a") == []


async def test_unsubscribe_of_nothing_is_a_warning(topic: DirectClient) -> None:
    """It is told only to clients that want warnings."""
    assert await topic.send(op="unsubscribe", topic="/a") == []
    await topic.send(op="set_level", level="info")
    (answer,) = await topic.send(op="unsubscribe", topic="/a")
    assert answer["level"] == "warning"


async def test_throttle_rate(topic: DirectClient) -> None:
    """Messages within the throttle time are left out."""
    await topic.send(op="subscribe", topic="/a", throttle_rate=60_000)
    assert await publish(topic, "x", "y") == ["x"]


async def test_cbor(topic: DirectClient) -> None:
    """A subscription with cbor brings bytes."""
    await topic.send(op="subscribe", topic="/a", compression="cbor")
    topic.graph.bus.publish("/a", {"data": "x"})
    data = await topic.client.outbox.get()
    assert isinstance(data, bytes)
    assert cbor2.loads(data) == {"op": "publish", "topic": "/a", "msg": {"data": "x"}}


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"topic": "/nope"}, "/nope"),
        ({"type": "std_msgs/Bool"}, "std_msgs/Bool"),
        ({"type": 5}, "type"),
        ({"throttle_rate": "fast"}, "throttle_rate"),
        ({"queue_length": -1}, "queue_length"),
        ({"fragment_size": 0.5}, "fragment_size"),
        ({"compression": "png"}, "png"),
        ({"topic": "/not a name"}, "not a name"),
    ],
)
async def test_wrong_field_subscribes_nothing(
    topic: DirectClient, wrong: dict[str, Any], named: str
) -> None:
    """What cannot be done is an error that names it, and leaves no subscription."""
    (answer,) = await topic.send(**({"op": "subscribe", "topic": "/a"} | wrong))
    assert answer["level"] == "error"
    assert named in answer["msg"]
    assert topic.client.subscriptions == {}
    assert topic.graph.bus.subscriber_names("/a") == []
