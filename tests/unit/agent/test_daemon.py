"""The whole agent against a real sshd and a fake relay, with OpenSSH's own client."""

from __future__ import annotations

import json
import logging

import aiohttp
import pytest
from aiohttp import web
from fake_cloud import echo, eventually
from openssh_server import listens
from robotether_agent import backoff
from robotether_agent.enrolment.keys import ensure_key
from robotether_agent.problems import AgentError, AlreadyRunningError, Retry, ServerKeyChangedError


async def test_joins_connects_and_forwards_both_services(make_cloud, start_agent):
    """A new robot joins, and rosbridge and video answer at its ports of the server."""
    cloud = await make_cloud()
    agent = start_agent(cloud)
    status = await agent.until_connected()
    assert status.robot == "sim1"
    # The agent is connected before its guard is ready, and the port leads to the guard.
    await eventually(lambda: listens(cloud.ports[0]), lambda: "the port of rosbridge is open")
    assert await echo(cloud.ports[0], "x" * 100_000) == "x" * 100_000
    async with (
        aiohttp.ClientSession() as http,
        http.get(f"http://127.0.0.1:{cloud.ports[1]}/") as page,
    ):
        assert await page.text() == "the list of topics"
    assert cloud.joins[0]["mac"] == "00:1b:44:11:3a:b7"
    assert "token" not in cloud.joins[0]


async def test_waits_for_approval_and_says_how(make_cloud, start_agent, caplog):
    """A pending robot tells how it is approved, asks again, and connects once it is."""
    caplog.set_level(logging.INFO)
    cloud = await make_cloud("pending")
    agent = start_agent(cloud)
    status = await agent.until(lambda status: status.state == "pending", "pending")
    assert status.problem_code == "not_enrolled"
    assert "robotether robot approve robot-00000a" in caplog.text
    key = await ensure_key(agent.settings.state_dir)
    assert status.fingerprint == key.fingerprint
    await eventually(lambda: len(cloud.joins) >= 3, lambda: "asks again")
    cloud.approve()
    await agent.until_connected()


async def test_refused_key_is_told_and_asked_about(make_cloud, start_agent):
    cloud = await make_cloud("refuses_key")
    agent = start_agent(cloud)
    status = await agent.until(lambda status: status.problem_code == "key_refused", "key_refused")
    assert status.state == "waiting"
    await eventually(lambda: len(cloud.joins) >= 2, lambda: "asks why")


async def test_changed_host_key_stops_the_agent(make_cloud, start_agent):
    """Another host key under the same address ends the agent for good, and loudly."""
    cloud = await make_cloud()
    agent = start_agent(cloud)
    await agent.until_connected()
    cloud.ssh.stop()
    cloud.ssh.new_host_key()
    cloud.ssh.start()
    with pytest.raises(ServerKeyChangedError, match="POSING AS THE SERVER"):
        await agent.until(lambda _: False, "the agent ends")
    assert agent.status().state == "stopped"
    assert agent.status().problem_code == "host_key_changed"


async def test_taken_port_is_told_and_tried_again(make_cloud, start_agent):
    """A port that something else holds is port_taken, and opens once it is free."""
    cloud = await make_cloud()
    holder = await make_cloud()
    cloud.ports = (holder.ssh.port, cloud.ports[1])
    agent = start_agent(cloud)
    await agent.until(lambda status: status.problem_code == "port_taken", "port_taken")
    holder.ssh.stop()
    await agent.until_connected()


async def test_new_ports_without_a_reconnect(make_cloud, start_agent):
    """A second configuration moves the forwards of the live connections."""
    cloud = await make_cloud("changes_ports")
    agent = start_agent(cloud)
    await agent.until_connected()
    await eventually(lambda: all(map(listens, cloud.other_ports)), lambda: "the new ports are open")
    await eventually(lambda: not any(map(listens, cloud.ports)), lambda: "the old ports are closed")
    assert await echo(cloud.other_ports[0], "moved") == "moved"
    assert len(cloud.of_kind("session", live=False)) == 1


async def test_session_failing_leaves_media_alone(make_cloud, start_agent):
    """When the session drops it comes back by itself, and the video connection never notices."""
    cloud = await make_cloud()
    agent = start_agent(cloud)
    await agent.until_connected()
    (await cloud.link("session")).drop()
    await cloud.link("session", number=2)
    await agent.until_connected()
    assert len(cloud.of_kind("media", live=False)) == 1


def _slowly_or_at_once(problem: AgentError, *_: object) -> float:
    return 60.0 if problem.retry is Retry.SLOWLY else 0.05


async def test_a_session_that_comes_back_brings_the_video_with_it(
    make_cloud, start_agent, monkeypatch
):
    """A robot that is let in again is seen as soon as it can be driven: no pause of the video's own outlasts it."""
    monkeypatch.setattr(backoff, "retry_or_give_up", _slowly_or_at_once)
    cloud = await make_cloud()
    agent = start_agent(cloud)
    await agent.until_connected()
    media = await cloud.link("media")
    media.send({"type": "bye", "code": "robot_disabled", "detail": "an admin disabled robot sim1"})
    await agent.until(lambda status: status.problem_code == "robot_disabled", "robot_disabled")
    (await cloud.link("session")).drop()
    await cloud.link("session", number=2)
    await cloud.link("media", number=2)


@pytest.mark.parametrize(
    ("mode", "code"),
    [
        ("silent", "server_silent"),
        ("sends_rubbish", "protocol_error"),
        ("supersedes", "superseded"),
        ("drops", "link_lost"),
    ],
)
async def test_misbehaving_server_is_named_and_tried_again(make_cloud, start_agent, mode, code):
    cloud = await make_cloud(mode)
    agent = start_agent(cloud)
    await agent.until(lambda status: status.problem_code == code, code)
    await cloud.link("session", number=2)
    cloud.mode = "serves"
    await agent.until_connected()


async def test_rosbridge_down_keeps_the_tunnel(make_cloud, start_agent, services):
    """When rosbridge goes away the server is told so, and the connection stays."""
    cloud = await make_cloud()
    agent = start_agent(cloud)
    await agent.until(lambda status: status.ros == "ok", "rosbridge is ok")
    link = await cloud.link("session")
    await services.stop()
    await eventually(
        lambda: link.of_type("health")[-1]["ros"] == "down", lambda: f"down in {link.received}"
    )
    assert "rosbridge at ws://127.0.0.1" in link.of_type("health")[-1]["detail"]
    assert agent.status().state == "connected"


async def test_second_agent_does_not_start(make_cloud, start_agent):
    """Two agents in one run directory would end each other's connections, so the second says no."""
    cloud = await make_cloud()
    await start_agent(cloud).until_connected()
    second = start_agent(cloud)
    with pytest.raises(AlreadyRunningError, match="another agent holds"):
        await second.task


async def test_unwritable_state_is_told_and_tried_again(make_cloud, start_agent, place):
    """A state directory that cannot be made is a clear problem, and the agent waits for it."""
    cloud = await make_cloud()
    (place / "disk").touch()
    agent = start_agent(cloud, state_dir=str(place / "disk/state"))
    status = await agent.until(lambda status: status.state == "waiting", "waiting")
    assert status.problem_code == "state_unusable"
    assert "set state_dir to a place" in status.advice
    (place / "disk").unlink()
    await agent.until_connected()


async def test_removed_robot_waits_for_its_approval(make_cloud, start_agent):
    """A robot whose row was removed finds out why its key is refused, and comes back once approved."""
    cloud = await make_cloud()
    agent = start_agent(cloud)
    await agent.until_connected()
    cloud.remove_robot()
    cloud.ssh.drop_connections()
    await agent.until(lambda status: status.state == "pending", "pending")
    cloud.approve()
    await agent.until_connected()


async def test_works_on_a_read_only_disk(make_cloud, start_agent):
    """Once enrolled, the agent writes nothing in its state directory."""
    cloud = await make_cloud()
    agent = start_agent(cloud)
    await agent.until_connected()
    await agent.stop()
    state = agent.settings.state_dir

    def stamps() -> dict[str, int]:
        return {path.name: path.stat().st_mtime_ns for path in [state, *state.iterdir()]}

    before = stamps()
    await start_agent(cloud).until_connected()
    assert stamps() == before


async def test_starts_before_the_network_is_there(make_cloud, start_agent, place):
    """Without an interface that names it a fresh robot says so, and joins once there is one."""
    cloud = await make_cloud()
    agent = start_agent(cloud, mac="", interface="none0")
    status = await agent.until(lambda status: status.state == "waiting", "waiting")
    assert status.problem_code == "interface_missing"
    kept = {"mac": "00:1b:44:11:3a:b7", "interface": "none0"}
    (place / "state/identity.json").write_text(json.dumps(kept))
    status = await agent.until_connected()
    assert (status.mac, status.interface) == ("00:1b:44:11:3a:b7", "")


async def test_survives_a_captive_portal(make_cloud, start_agent):
    """Something that answers in the server's place is named, trusted with nothing, and outlived."""
    cloud = await make_cloud()
    cloud.answer = lambda: web.Response(status=302, headers={"Location": "https://hotel/"})
    agent = start_agent(cloud)
    status = await agent.until(lambda status: status.state == "waiting", "waiting")
    assert status.problem_code == "answer_invalid"
    assert "captive portal" in status.advice
    cloud.answer = cloud.active
    await agent.until_connected()
