"""When a robot begins and ceases to be needed."""

import asyncio

from robotether_server.relay.robots.demand import Demand


async def test_a_robot_with_published_ports_is_always_needed():
    changes = []
    demand = Demand(lambda: changes.append(True), always=True, kept_s=0)
    with demand.counted():
        pass
    await asyncio.sleep(0.01)
    assert (changes, demand.exists) == ([], True)
