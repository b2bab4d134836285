"""Leases through the whole relay: who drives, who waits, and what robots and drivers are told."""

from contextlib import AsyncExitStack

import pytest
from relay_clients import SlowFences, closing
from relay_server import BEN, CARL, until
from robotether_common.session import MAX_FENCE
from robotether_server.relay.control import leasing
from robotether_server.relay.robots import lease as lease_module

pytestmark = pytest.mark.usefixtures("no_command_is_late")


@pytest.fixture(autouse=True)
def rights(memory_database, sim1):
    memory_database.grants[BEN.id, sim1.id] = "drive"
    memory_database.grants[CARL.id, sim1.id] = "manage"


def control(relay, sim1):
    return relay.relay.control.describe(sim1.id)


async def driven(relay, sim1):
    await until(lambda: relay.relay.control.driver(sim1.id) == "ann", "ann drives")


@pytest.mark.parametrize("lie", [2**53 - 1, MAX_FENCE])
async def test_a_robot_that_lied_of_its_fence_can_be_driven_when_it_is_mended(
    relay, guarded, sim1, lie, ros
):
    """There are numbers above any that a robot can report, and its guard may report those."""
    presence = relay.relay.registry.presence
    guarded.session.send_guard_status(fence=lie)
    await until(lambda: presence(sim1.id).report.fence, "it is known")
    for handshakes in (1, 2):
        async with ros():
            fence = int((await guarded.connections(handshakes))[-1]["Robotether-Fence"])
            assert 2**53 <= fence < MAX_FENCE
            guarded.session.send_guard_status(fence=fence, held=handshakes)
            count = ("held", handshakes)
            await until(
                lambda count=count: count in presence(sim1.id).report.refused, "the session lives"
            )


async def test_a_new_lease_waits_for_the_guards_first_report(relay, start_robot, sim1, ros):
    """Who is faster than that drives at the first attempt, too."""
    robot = await start_robot(relay, "guard_quiet")
    async with ros():
        await until(lambda: relay.relay.registry.robot(sim1.id).usage.exists, "the driver is there")
        assert not robot.handshakes
        robot.session.send_guard_status(fence=500)
        (handshake,) = await robot.connections(1)
    assert handshake["Robotether-Fence"] == "501"


async def test_commands_put_off_that_the_control_passes_on(relay, guarded, sim1, ros):
    """Only messages on a drive topic show that the driver is there."""
    async with ros() as socket:
        await driven(relay, sim1)
        relay.relay.control.leasing.ask(sim1, leasing.LeaseRequester(BEN))
        lease = relay.relay.control.leasing.of(sim1.id)
        before = lease.passes_at().s
        await socket.send_json({"op": "subscribe", "topic": "/pose"})
        await until(lambda: guarded.received, "the robot has the subscription")
        assert lease.passes_at().s == before
        await socket.send_json({"op": "publish", "topic": "/cmd_vel", "msg": {}})
        await until(lambda: lease.passes_at().s > before, "the command is noted")


async def test_a_kept_lease_is_free_after_its_time(relay, guarded, sim1, monkeypatch, ros):
    """Who asked and does not come keeps nobody out for long, and those who watch are told."""
    monkeypatch.setattr(lease_module, "RESERVED_FOR_S", 0.2)
    reserved = []
    async with ros():
        await driven(relay, sim1)
        relay.relay.control.listen(
            lambda _robot_id: reserved.append(control(relay, sim1).reserved is not None)
        )
        relay.relay.control.leasing.take(sim1, leasing.LeaseRequester(CARL))
    await until(lambda: reserved[-2:] == [True, False], "those who watch are told")


@pytest.mark.parametrize("has_older", [False, True])
async def test_a_stop_while_the_number_is_on_its_way_wins(
    *, relay, guarded, sim1, memory_database, monkeypatch, has_older, ros
):
    """The connection that drives and the one that waits for its number both end with the stop."""
    slow, older = SlowFences(memory_database), None
    async with AsyncExitStack() as stack:
        if has_older:
            older = await stack.enter_async_context(ros())
            await guarded.connections(1)
        monkeypatch.setattr(memory_database, "next_fence", slow.next_fence)
        newer = await stack.enter_async_context(ros())
        await slow.asked.wait()
        relay.relay.control.stops.stop(sim1, "ben")
        if older is not None:
            assert (await closing(older))[0] == 4003
            slow.go_on.set()
        assert (await closing(newer))[0] == 4003
        slow.go_on.set()
    assert relay.relay.control.driver(sim1.id) is None
    assert guarded.clients_ever == has_older


async def test_who_lost_the_right_waits_no_more(relay, guarded, sim1, memory_database, ros):
    async with ros():
        await driven(relay, sim1)
        relay.relay.control.leasing.ask(sim1, leasing.LeaseRequester(BEN))
        del memory_database.grants[BEN.id, sim1.id]
        await relay.relay.fleet.poll()
        assert control(relay, sim1).waiting is None
