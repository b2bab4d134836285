"""One join in the foreground, by the command itself against a real server over TLS."""

from __future__ import annotations

import asyncio

from aiohttp import web
from fake_cloud import FakeCloud, agent_environ
from robotether_agent.cli.main import main
from robotether_agent.enrolment.keys import ensure_key


async def joined(cloud: FakeCloud, place, **more: str) -> int:
    """Run the command in a thread, since it has a loop of its own."""
    return await asyncio.to_thread(main, ["join"], agent_environ(cloud, place, **more))


async def test_active(make_cloud, place, capsys):
    """A robot that is let in is told its name; asking again is no harm."""
    cloud = await make_cloud()
    for _ in range(2):
        assert await joined(cloud, place) == 0
        told = capsys.readouterr().out
        assert told == f"active: {cloud.server} knows this robot as sim1 (MAC 00:1b:44:11:3a:b7)\n"
    assert len({said["public_key"] for said in cloud.joins}) == 1


async def test_pending(make_cloud, place, capsys):
    """How it is approved and the key to compare are told."""
    assert await joined(await make_cloud("pending"), place) == 10
    told = capsys.readouterr().out
    key = await ensure_key(place / "state")
    assert told.startswith("pending: cannot connect to")
    assert "robotether robot approve robot-00000a" in told
    assert key.fingerprint in told


async def test_refused_and_impossible(make_cloud, place, capsys):
    """The server's reason and what to do are told, and so is a server that is away."""
    cloud = await make_cloud()
    refusal = {"code": "token_used_up", "detail": "the token lab was used 10 of 10 times"}
    cloud.answer = lambda: web.json_response(refusal, status=401)
    assert await joined(cloud, place, token="rj_x") == 1
    assert "was used 10 of 10 times; make a join token with more uses" in capsys.readouterr().err
    await cloud.stop_web()
    assert await joined(cloud, place) == 1
    assert "cannot reach https://" in capsys.readouterr().err


async def test_beside_a_running_agent(make_cloud, start_agent, place, capsys):
    """The tunnels stay, and both have one key."""
    cloud = await make_cloud()
    agent = start_agent(cloud)
    await agent.until_connected()
    assert await joined(cloud, place) == 0
    assert agent.status().state == "connected"
    assert [len(cloud.of_kind(kind, live=False)) for kind in ("session", "media")] == [1, 1]
