"""Operations of the real rosbridge that the simulator lacks."""

import pytest
from sim_client import DirectClient
from sim_robot.rosbridge.operations.refused import REFUSED


@pytest.mark.parametrize("name", REFUSED)
async def test_refused_by_name(client: DirectClient, name: str) -> None:
    """Each is answered with an error that names it, and not as unknown."""
    (answer,) = await client.send(op=name, service="/a", id="r")
    assert answer["id"] == "r"
    assert answer["msg"] == f"{name}: the simulated robot does not offer the operation {name}"
