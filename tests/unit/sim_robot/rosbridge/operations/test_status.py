"""set_level and status."""

import pytest
from sim_client import DirectClient


async def test_none_silences(client: DirectClient) -> None:
    """With level none even errors are not told."""
    await client.send(op="set_level", level="none")
    assert await client.send(op="dance") == []


@pytest.mark.parametrize("level", ["loud", "", 3, None])
async def test_unknown_level_changes_nothing(client: DirectClient, level: object) -> None:
    """A level that does not exist is an error."""
    (answer,) = await client.send(op="set_level", level=level)
    assert "level" in answer["msg"]
    assert client.client.level == "error"


async def test_status_of_the_client_is_taken(client: DirectClient) -> None:
    """A client may report, and gets no answer."""
    assert await client.send(op="status", level="info", msg="all well") == []
