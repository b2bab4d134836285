"""Who is accepted on the port for robots' sessions, over real sockets, and who may stay."""

import asyncio
import contextlib
from dataclasses import replace

import pytest
from fake_robot import HOST, WAIT_S, RobotSession
from relay_clients import configured, ended
from relay_server import SESSION_KEY, running_relay
from robotether_server.relay.options import Timing

KINDS = ("session", "media")


@pytest.mark.parametrize(
    "line", [b"\x00\xff\n", b"{}\n", b'{"type": "preface"}\n', b"x" * 70_000, b'{"type": ']
)
async def test_rubbish_instead_of_a_preface_gets_no_answer(relay, line):
    reader, writer = await asyncio.open_connection(HOST, relay.relay.session_port)
    writer.write(line)
    writer.write_eof()
    with contextlib.suppress(ConnectionError):
        assert await asyncio.wait_for(reader.read(), WAIT_S) == b""
    writer.close()


async def test_a_robot_newer_than_the_last_poll_is_admitted(memory_database):
    async with running_relay(memory_database, Timing(poll_every_s=3600)) as relay:
        memory_database.add_robot(8, "sim8")
        session = RobotSession(8, kind="session", session_key=SESSION_KEY)
        await session.connect(relay.relay.session_port)
        await configured(session)
        await session.close()


async def test_a_rotated_key_keeps_its_links_and_a_replaced_one_does_not(
    relay, sim1, memory_database, connect
):
    async def rotate(to, previous=None):
        keys = {"fingerprint": f"SHA256:{to}", "previous_fingerprint": previous}
        memory_database.robots = {sim1.id: replace(sim1, **keys)}
        await relay.relay.fleet.poll()

    await rotate("a")
    links = [await configured(await connect(kind, fingerprint="SHA256:a")) for kind in KINDS]
    await rotate("b", "SHA256:a")
    assert [link.bye for link in links] == [None, None]
    await rotate("c", "SHA256:b")
    assert [await ended(link) for link in links] == ["key_changed"] * 2


async def test_a_relay_that_has_never_read_the_database_says_so(memory_database):
    memory_database.down = True
    async with running_relay(memory_database) as relay:
        session = RobotSession(7, kind="session", session_key=SESSION_KEY)
        await session.connect(relay.relay.session_port)
        assert await ended(session) == "not_ready"
        await session.close()
