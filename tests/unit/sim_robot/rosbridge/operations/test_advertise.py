"""advertise and unadvertise."""

from sim_client import DirectClient


async def test_topic_appears_and_goes(client: DirectClient) -> None:
    """An advertised topic exists until it is unadvertised, without a word to the client."""
    assert (
        await client.send(op="advertise", topic="/a", type="std_msgs/msg/String", latch=False) == []
    )
    assert client.graph.bus.topics() == {"/a": "std_msgs/String"}
    assert await client.send(op="unadvertise", topic="/a") == []
    assert client.graph.bus.topics() == {}


async def test_ids_count(client: DirectClient) -> None:
    """A topic that was advertised with two ids stays until both are taken back."""
    for name in ("one", "two"):
        await client.send(op="advertise", topic="/a", type="std_msgs/String", id=name)
    await client.send(op="unadvertise", topic="/a", id="one")
    assert "/a" in client.graph.bus.topics()
    await client.send(op="unadvertise", topic="/a", id="two")
    assert client.graph.bus.topics() == {}


async def test_other_type_is_an_error(client: DirectClient) -> None:
    """The second type is refused by name, the first stays."""
    await client.send(op="advertise", topic="/a", type="std_msgs/String")
    (answer,) = await client.send(op="advertise", topic="/a", type="std_msgs/Bool", id="x")
    assert (answer["level"], answer["id"]) == ("error", "x")
    assert "advertise: cannot use /a as std_msgs/Bool" in answer["msg"]
    assert client.graph.bus.topics() == {"/a": "std_msgs/String"}


async def test_unknown_type_and_missing_type(client: DirectClient) -> None:
    """Both are errors and leave no topic behind."""
    (unknown,) = await client.send(op="advertise", topic="/a", type="my_msgs/Thing")
    assert "my_msgs/Thing" in unknown["msg"]
    (missing,) = await client.send(op="advertise", topic="/a")
    assert "type" in missing["msg"]
    assert client.graph.bus.topics() == {}


async def test_unadvertise_of_nothing_is_a_warning(client: DirectClient) -> None:
    """It is told only to clients that want warnings."""
    assert await client.send(op="unadvertise", topic="/a") == []
    await client.send(op="set_level", level="warning")
    (answer,) = await client.send(op="unadvertise", topic="/a")
    assert answer["level"] == "warning"
