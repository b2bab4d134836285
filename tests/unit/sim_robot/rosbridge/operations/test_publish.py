"""publish."""

from sim_client import DirectClient


async def test_message_comes_back_to_its_sender(client: DirectClient) -> None:
    """A client that subscribed to its own topic gets its message, filled up."""
    await client.send(op="subscribe", topic="/a", type="geometry_msgs/Vector3")
    await client.send(op="advertise", topic="/a", type="geometry_msgs/Vector3")
    assert await client.send(op="publish", topic="/a", msg={"x": 1}) == [
        {"op": "publish", "topic": "/a", "msg": {"x": 1.0, "y": 0.0, "z": 0.0}}
    ]


async def test_other_clients_get_it(client: DirectClient) -> None:
    """Two clients of one robot share its topics."""
    other = DirectClient(client.graph)
    await other.send(op="subscribe", topic="/a", type="std_msgs/String")
    await client.send(op="publish", topic="/a", msg={"data": "x"})
    assert [message["msg"] for message in await other.received()] == [{"data": "x"}]


async def test_publish_advertises_on_the_way(client: DirectClient) -> None:
    """With a type an unknown topic comes to be; without one it is an error."""
    (answer,) = await client.send(op="publish", topic="/a", msg={"data": "x"})
    assert "cannot find the type of /a" in answer["msg"]
    assert (
        await client.send(op="publish", topic="/a", type="std_msgs/String", msg={"data": "x"}) == []
    )
    assert client.graph.bus.publisher_names("/a") == ["/rosbridge_websocket"]


async def test_publish_with_another_type_is_an_error(client: DirectClient) -> None:
    """The type in a publish must be the topic's, the first time and later."""
    await client.send(op="subscribe", topic="/a", type="std_msgs/String")
    for _ in range(2):
        (answer,) = await client.send(
            op="publish", topic="/a", type="std_msgs/Bool", msg={"data": True}
        )
        assert "publish: cannot use /a as std_msgs/Bool" in answer["msg"]
        await client.send(op="advertise", topic="/a", type="std_msgs/String")


async def test_wrong_message_is_an_error_and_goes_nowhere(client: DirectClient) -> None:
    """A message that does not fit is refused, with and without a subscriber."""
    await client.send(op="advertise", topic="/a", type="std_msgs/String")
    for _ in range(2):
        (answer,) = await client.send(op="publish", topic="/a", msg={"text": "x"}, id=9)
        assert answer == {
            "op": "status",
            "level": "error",
            "id": 9,
            "msg": "publish: std_msgs/msg/String has no field text",
        }
        await client.send(op="subscribe", topic="/a")
    (answer,) = await client.send(op="publish", topic="/a", msg=[1])
    assert "msg to be an object" in answer["msg"]


async def test_relative_name_is_the_same_topic(client: DirectClient) -> None:
    """`a` and `/a` are one topic; each subscriber hears the name that it used."""
    await client.send(op="subscribe", topic="a", type="std_msgs/String")
    (message,) = await client.send(op="publish", topic="/a", msg={"data": "x"})
    assert message["topic"] == "a"
