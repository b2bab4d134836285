"""When a robot begins and ceases to need its media connection."""

import asyncio

from robotether_server.relay.robots.media_demand import MediaDemand


async def test_viewers_of_each_robot_count_and_the_last_leaves_it_open_for_a_while():
    """Only a beginning and an end are reported; a viewer within that while is neither."""
    changed: list[int] = []
    demand = MediaDemand(changed.append, kept_s=0.01)
    with demand.watched(7):
        with demand.watched(7), demand.watched(8):
            assert (demand.needs(7), demand.needs(8), demand.needs(9)) == (True, True, False)
        with demand.watched(8):
            pass
        await asyncio.sleep(0.05)
        assert (changed, demand.needs(7), demand.needs(8)) == ([7, 8, 8], True, False)
    assert demand.needs(7)
    await asyncio.sleep(0.05)
    assert (changed, demand.needs(7)) == ([7, 8, 8, 7], False)


async def test_published_ports_need_it_always():
    """Nobody is told of anything."""
    changed: list[int] = []
    demand = MediaDemand(changed.append, always=True, kept_s=0)
    assert demand.needs(7)
    with demand.watched(7):
        pass
    await asyncio.sleep(0.01)
    assert (changed, demand.needs(7)) == ([], True)


async def test_close_ends_what_still_waits():
    """The relay stops."""
    changed: list[int] = []
    demand = MediaDemand(changed.append, kept_s=0.01)
    with demand.watched(7):
        pass
    demand.close()
    await asyncio.sleep(0.05)
    assert changed == [7]
