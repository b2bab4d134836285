"""Who is connected to a robot's rosbridge, and how the robot is reached."""

import asyncio
import time
from dataclasses import replace
from datetime import timedelta

import pytest
from relay_clients import closing, refusal
from relay_server import ANN, FAST, running_relay, until
from robotether_server.db.cells import Cell
from robotether_server.relay.auth.credentials import credential_of
from robotether_server.relay.http.sockets import OperatorSocket
from robotether_server.times import utc_now


async def test_nobody_drives_before_the_agent_has_read_that_heartbeats_are_quick(guarded, ros):
    """An earlier ping's answer does not show that. Who observes need not wait."""
    session = guarded.session
    session.silent, answered = True, session.pings
    await until(lambda: session.pings > answered, "a ping is not answered")
    earlier = session.pings
    async with ros():
        await until(lambda: len(session.configs) == 2, "the agent is told")
        session.send(type="pong", seq=earlier)
        async with ros("observe"):
            await until(lambda: guarded.clients_ever, "the observer is there")
        await asyncio.sleep(0.2)
        assert guarded.clients_ever == 1
        session.silent = False
        await until(lambda: guarded.clients_ever == 2, "the driver is there")


async def test_a_tunnel_without_its_port_is_told_within_a_second(robot, ros):
    await robot._close_ports()
    began_s = time.monotonic()
    async with ros() as socket:
        assert (await closing(socket))[0] == 4504
    assert 0.5 < time.monotonic() - began_s < 2


@pytest.mark.parametrize("is_older", [True, False])
async def test_a_ticket_of_before_the_robot_came_to_this_cell_is_expired(
    *, relay, start_robot, sim1, http, memory_database, is_older, ros
):
    """The other cell may have used it; a clock that was set back makes no new ticket one of before."""
    memory_database.cells["b"] = Cell(
        "b", "b.example", 443, (2222,), "b.example:8444", "0.1.0", 0, False, True
    )
    await until(relay.relay.cells.peers, "the other cell is known")
    registry = relay.relay.registry
    if is_older:
        registry._monotonic = lambda: time.monotonic() + 5
    else:
        registry._clock = lambda: utc_now() + timedelta(hours=1)
    robot = await start_robot(relay)
    if is_older:
        assert await refusal(http, relay.ros_url(sim1)) == 401
    else:
        async with ros():
            await until(lambda: robot.clients, "the operator has reached rosbridge")


@pytest.mark.parametrize(
    ("down", "code", "reason"),
    [
        (False, 4001, "your rights on robot sim1 have ended or changed"),
        (True, 4510, "cannot let you drive sim1: the database does not answer; try again shortly"),
    ],
)
async def test_a_drive_begins_only_with_a_credential_that_holds_now(
    *, memory_database, start_robot, sim1, http, down, code, reason
):
    """The relay has not yet read that the token is gone, and asks before the lease begins."""
    seldom = replace(FAST, poll_every_s=60)
    async with running_relay(memory_database, seldom) as relay:
        await start_robot(relay, "guarded")
        await until(lambda: relay.relay.registry.presence(sim1.id).guard == "ready", "it is well")
        token = credential_of("token", memory_database.add_credential("token", ANN))
        url = relay.ros_url(sim1, credential=token)
        del memory_database.credentials[token]
        memory_database.down = down
        async with http.ws_connect(url) as socket:
            assert await closing(socket) == (code, reason)
        assert memory_database.fences == {}
        memory_database.down = False


async def test_a_right_that_ends_during_the_upgrade_ends_the_connection(
    *, relay, robot, sim1, memory_database, monkeypatch, ros
):
    """Nothing may slip in between the check of the grant and the watch on it."""
    really_open = OperatorSocket.open

    async def open_late(self, request):
        del memory_database.grants[1, sim1.id]
        await relay.relay.fleet.poll()
        await really_open(self, request)

    monkeypatch.setattr(OperatorSocket, "open", open_late)
    async with ros() as socket:
        assert (await closing(socket))[0] == 4001
    assert robot.clients_ever == 0
