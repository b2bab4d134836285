"""Where a robot connects to: the order of the server's machines, and which of them gets its session."""

import asyncio
import json
from pathlib import Path

import pytest
from fake_cloud import eventually
from robotether_agent.enrolment.enroller import ENROLMENT_FILE, Enroller, Enrolment
from robotether_agent.enrolment.join import SshAccess
from robotether_agent.enrolment.keys import KeyPair, ensure_key
from robotether_agent.fields import ListedCell
from robotether_agent.net.server_dialer import NEXT_CELL_AFTER_S, ServerDialer
from robotether_agent.problems import (
    AgentError,
    LinkLostError,
    Retry,
    ServerSilentError,
    ServerUnreachableError,
    SessionEndedError,
)
from robotether_agent.settings import Settings
from robotether_agent.tunnel.connection import Role
from robotether_agent.tunnel.connector import Connector

NOBODY = {"host": "127.0.0.1", "ports": [1]}

MAC = "00:1b:44:11:3a:b7"
A, B = ListedCell("a.example", (2222, 443)), ListedCell("b.example", (2222,))


@pytest.mark.parametrize(
    ("host", "cells", "settings", "expected"),
    [
        (None, (), {}, ["a.example 2222", "a.example 443"]),
        ("ssh.example", (), {}, ["ssh.example 2222", "ssh.example 443"]),
        ("ssh.example", (A, B), {"ssh_host": "c.example", "ssh_ports": (22,)}, ["c.example 22"]),
        (None, (B, A), {"ssh_ports": (443,)}, ["b.example 443", "a.example 443"]),
        (None, (B, A), {}, ["b.example 2222", "a.example 2222", "a.example 443"]),
        ("old.example", (B,), {}, ["b.example 2222", "old.example 2222", "old.example 443"]),
    ],
)
def test_the_settings_come_before_the_joins_answer(host, cells, settings, expected):
    values = Settings(server="a.example:8443", state_dir=Path("/none"), **settings)
    access = SshAccess("tunnel", host, (2222, 443), cells)
    targets = Connector(values, Enroller(values)).targets(access, "session")
    assert [f"{target.host} {target.port}" for target in targets] == expected


@pytest.fixture
def dial(monkeypatch):
    found = []

    async def find(_, targets, *, unreached_s):
        found.append((targets[0].cell, unreached_s))
        return targets[0]

    async def connect(cells, end, times):
        async def run(target, _, role):
            problem = end(target)
            if not isinstance(problem, ServerUnreachableError):
                role.on_up(target, None, None)
            raise problem

        monkeypatch.setattr(ServerDialer, "find", find)
        monkeypatch.setattr("robotether_agent.tunnel.connector.run_connection", run)
        values = Settings(server="a.example:8443", state_dir=Path("/none"))
        connector = Connector(values, Enroller(values))
        access = SshAccess("tunnel", None, A.ports, cells)
        enrolment = Enrolment(values.server, "sim1", MAC, access)
        role = Role(kind="session", target=lambda: None, on_up=lambda *_: None)
        for _ in range(times):
            with pytest.raises(AgentError):
                await connector.connect(enrolment, KeyPair(Path("/none"), ""), role)
        return found

    return connect


@pytest.mark.parametrize(
    ("problem", "again"),
    [
        (ServerSilentError("not reached", retry=Retry.AT_ONCE), (B, NEXT_CELL_AFTER_S)),
        (ServerSilentError("reached, and its relay says nothing"), (A, 0.0)),
        (SessionEndedError("the relay has ended", code="relay_lost"), (A, 0.0)),
        (SessionEndedError("a newer session took over", code="superseded"), (B, 0.0)),
        (LinkLostError("reset"), (B, 0.0)),
    ],
)
async def test_a_cell_that_just_fell_silent_gets_no_more_time(problem, again, dial):
    """The others are tried beside it, or before it; one that ended its connection may be back in a moment."""
    assert await dial((B, A), lambda _: problem, times=2) == [(B, 0.0), again]


@pytest.mark.parametrize(
    ("took_s", "tried"),
    [(15.0, ["a 2222", "b 2222", "a 443"]), (0.1, ["a 2222", "a 443", "b 2222"])],
)
async def test_after_a_cell_that_hangs_the_others_come_first(took_s, tried, dial, monkeypatch):
    """Its other port would take as long again; one that refuses there may be let through here."""
    now, targets_tried = [0.0], []

    def hang(target):
        targets_tried.append(f"{target.host.removesuffix('.example')} {target.port}")
        now[0] += took_s
        return ServerUnreachableError("timed out")

    monkeypatch.setattr("robotether_agent.tunnel.connector.monotonic", lambda: now[0])
    await dial((A, B), hang, times=1)
    assert targets_tried == tried


async def test_a_server_that_moved_is_found_by_the_web(cloud, start_agent, monkeypatch):
    monkeypatch.setattr("robotether_agent.net.server_dialer.FIND_TIMEOUT_S", 1.0)
    monkeypatch.setattr("robotether_agent.tunnel.connector.ASK_WEB_AFTER_S", 0.0)
    monkeypatch.setattr("robotether_agent.tunnel.connector.ASK_WEB_EVERY_S", 0.0)
    agent = start_agent(cloud)
    await agent.until_connected()
    joins = len(cloud.joins)
    with monkeypatch.context() as cut:
        cut.setattr("robotether_agent.net.tcp._connect", _never)
        cloud.ssh.drop_connections()
        await eventually(lambda: len(cloud.joins) > joins, lambda: "the web was asked")
    await agent.until_connected()


@pytest.fixture
async def site(make_cloud, place):
    """Makes a server of so many machines that let the robot in; only the first has a web."""

    async def make(count=2):
        first, *others = [await make_cloud() for _ in range(count)]
        (place / "state").mkdir(mode=0o700)
        key = await ensure_key(place / "state")
        for other in others:
            await other.be_of_site(first)
            other.authorize(key.public)
        machines = [first, *others]
        for machine in machines:
            # The own one first, as the server has it.
            rest = [item.cell for item in machines if item is not machine]
            machine.cells = [machine.cell, *rest]
        return machines

    return make


def kept(place):
    cells = json.loads((place / "state" / ENROLMENT_FILE).read_text())["ssh"]["cells"]
    return [{name: cell[name] for name in ("host", "ports")} for cell in cells]


async def at(cloud, kind="session"):
    await eventually(lambda: bool(cloud.of_kind(kind)), lambda: f"{kind} at {cloud.cell}")


async def test_a_machine_out_of_service_hands_over_its_robot_by_its_newest_list(
    site, start_agent, place
):
    """The list arrives right before the bye, and lasts over a restart of the agent; the video follows."""
    first, second = await site()
    agent = start_agent(first)
    await agent.until_connected()
    second.cells = [second.cell]
    first.configure(cells=[second.cell])
    link = await first.link("session")
    link.send({"type": "bye", "code": "cell_draining", "detail": "connect to the next"})
    await at(second)
    await at(second, "media")
    # Also when its own connection to the machine before still works.
    await eventually(lambda: not first.of_kind("media"), lambda: "the old one has ended")
    await agent.stop()
    assert kept(place) == [second.cell]
    sessions = len(first.of_kind("session", live=False))
    await first.stop_web()
    await start_agent(first).until_connected()
    assert second.of_kind("session")
    assert len(first.of_kind("session", live=False)) == sessions


async def test_a_machine_with_another_host_key_is_passed_over(site, start_agent, make_cloud):
    first, second = await site()
    stranger = await make_cloud()
    first.cells = [NOBODY, stranger.cell, second.cell]
    agent = start_agent(first)
    status = await agent.until_connected()
    assert status.ssh == f"127.0.0.1 port {second.ssh.port}"
    assert "Accepted publickey" not in stranger.ssh.log_text()
    assert stranger.links == []


async def test_a_wrong_host_key_beside_a_dead_machine_does_not_end_the_agent(
    site, start_agent, make_cloud, caplog
):
    (first,) = await site(1)
    stranger = await make_cloud()
    first.cells = [first.cell, stranger.cell]
    agent = start_agent(first)
    await agent.until_connected()
    first.ssh.stop()
    await agent.until(lambda status: status.problem_code == "host_key_changed", "a stranger")
    assert "POSING AS THE SERVER there" in caplog.text
    first.ssh.start()
    await agent.until_connected()
    assert stranger.links == []


async def test_a_key_that_is_refused_is_refused_by_the_server(site, start_agent):
    """The robot asks the web why, and does not try its key at machine after machine."""
    first, second = await site()
    first.mode = "refuses_key"
    agent = start_agent(first)
    await agent.until(lambda status: status.problem_code == "key_refused", "key_refused")
    await eventually(lambda: len(first.joins) >= 2, lambda: "asks why")
    assert "Accepted publickey" not in second.ssh.log_text()


async def test_a_machine_whose_relay_hangs_comes_last(site, start_agent, monkeypatch):
    monkeypatch.setattr("robotether_agent.tunnel.connection.RELAY_ANSWERS_WITHIN_S", 2.0)
    first, second = await site()
    second.cells = first.cells
    first.mode = "hangs"
    status = await start_agent(first).until_connected()
    assert status.ssh == f"127.0.0.1 port {second.ssh.port}"
    assert len(first.of_kind("session", live=False)) == 1


async def test_the_only_relay_is_waited_for(site, start_agent, monkeypatch):
    monkeypatch.setattr("robotether_agent.tunnel.connection.RELAY_ANSWERS_WITHIN_S", 0.2)
    (first,) = await site(1)
    first.cells = None
    first.mode = "hangs"
    start_agent(first)
    await at(first)
    await asyncio.sleep(5 * 0.2)
    assert len(first.of_kind("session")) == 1


async def _never(*_):
    await asyncio.Event().wait()
    raise AssertionError("nothing sets it")
