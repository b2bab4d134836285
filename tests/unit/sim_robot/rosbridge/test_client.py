"""One client's state: it ends with the client, and is bounded."""

import pytest
from sim_client import DirectClient
from sim_robot.problems import ClientLimit
from sim_robot.rosbridge.client import TOPICS_LIMIT


async def test_close_gives_everything_back(client: DirectClient) -> None:
    """After the close none of the client's topics is left."""
    await client.send(op="advertise", topic="/a", type="std_msgs/String")
    await client.send(op="subscribe", topic="/b", type="std_msgs/String")
    assert client.graph.bus.topics().keys() == {"/a", "/b"}
    client.client.close()
    assert client.graph.bus.topics() == {}


async def test_topics_are_bounded(client: DirectClient) -> None:
    """A client cannot take topics without end, neither by topics nor by ids of one topic."""
    for number in range(TOPICS_LIMIT):
        await client.send(op="subscribe", topic="/a", type="std_msgs/String", id=f"s{number}")
    (answer,) = await client.send(op="advertise", topic="/b", type="std_msgs/String")
    assert str(TOPICS_LIMIT) in answer["msg"]
    with pytest.raises(ClientLimit):
        client.client.check_limit()


async def test_status_level_filters(client: DirectClient) -> None:
    """Below the level nothing is sent."""
    client.client.level = "warning"
    client.client.status("info", "quiet", None)
    client.client.status("warning", "heard", "x")
    assert await client.received() == [
        {"op": "status", "level": "warning", "msg": "heard", "id": "x"}
    ]
