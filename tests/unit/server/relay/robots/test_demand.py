"""When a robot begins and ceases to be needed."""

import asyncio

from robotether_server.relay.robots.demand import Demand


async def test_the_last_user_is_remembered_for_a_while():
    """Demand reports only its beginning and its end; whoever comes within that while is neither."""
    changes = []
    demand = Demand(lambda: changes.append(demand.exists), kept_s=0.01)
    with demand.counted():
        with demand.counted():
            assert demand.exists
        await asyncio.sleep(0.05)
        assert changes == [True]
    with demand.counted():
        pass
    assert (changes, demand.exists) == ([True], True)
    await asyncio.sleep(0.05)
    assert (changes, demand.exists) == ([True, False], False)


async def test_a_robot_with_published_ports_is_always_needed():
    changes = []
    demand = Demand(lambda: changes.append(True), always=True, kept_s=0)
    with demand.counted():
        pass
    await asyncio.sleep(0.01)
    assert (changes, demand.exists) == ([], True)
