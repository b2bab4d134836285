"""When a robot begins and ceases to be needed."""

import asyncio

from robotether_server.relay.robots.demand import Demand


async def test_those_who_need_a_robot_count_and_the_last_is_remembered_for_a_while():
    """Only a beginning and an end are reported; who comes within that while is neither."""
    changed: list[int] = []
    demand = Demand(changed.append, kept_s=0.01)
    with demand.counted(7):
        with demand.counted(7), demand.counted(8):
            assert (demand.of(7), demand.of(8), demand.of(9)) == (True, True, False)
        with demand.counted(8):
            pass
        await asyncio.sleep(0.05)
        assert (changed, demand.of(7), demand.of(8)) == ([7, 8, 8], True, False)
    assert demand.of(7)
    await asyncio.sleep(0.05)
    assert (changed, demand.of(7)) == ([7, 8, 8, 7], False)


async def test_with_published_ports_each_robot_is_needed_always():
    """Nobody is told of anything."""
    changed: list[int] = []
    demand = Demand(changed.append, always=True, kept_s=0)
    assert demand.of(7)
    with demand.counted(7):
        pass
    await asyncio.sleep(0.01)
    assert (changed, demand.of(7)) == ([], True)


async def test_close_ends_what_still_waits():
    """The relay stops."""
    changed: list[int] = []
    demand = Demand(changed.append, kept_s=0.01)
    with demand.counted(7):
        pass
    demand.close()
    await asyncio.sleep(0.05)
    assert changed == [7]
