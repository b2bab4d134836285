"""The whole agent against a real sshd and a fake relay, with OpenSSH's own client."""

import json

import pytest
from fake_cloud import eventually
from robotether_agent import backoff
from robotether_agent.files import LOCK, ensure_directory, only_one
from robotether_agent.problems import AlreadyRunningError, Retry


async def test_taken_port_is_told_and_tried_again(make_cloud, start_agent):
    cloud = await make_cloud()
    holder = await make_cloud()
    cloud.ports = (holder.ssh.port, cloud.ports[1])
    agent = start_agent(cloud)
    await agent.until(lambda status: status.problem_code == "port_taken", "port_taken")
    holder.ssh.stop()
    await agent.until_connected()


def _slowly_or_at_once(problem, *_):
    return 60.0 if problem.retry is Retry.SLOWLY else 0.05


async def test_a_session_that_comes_back_brings_the_video_with_it(cloud, start_agent, monkeypatch):
    monkeypatch.setattr(backoff, "retry_or_give_up", _slowly_or_at_once)
    agent = start_agent(cloud)
    await agent.until_connected()
    (await cloud.link("session")).drop()
    await cloud.link("session", number=2)
    await agent.until_connected()
    assert len(cloud.of_kind("media", live=False)) == 1
    media = await cloud.link("media")
    media.send({"type": "bye", "code": "robot_disabled", "detail": "an admin disabled robot sim1"})
    await agent.until(lambda status: status.problem_code == "robot_disabled", "robot_disabled")
    # No pause of the video's own outlasts it.
    (await cloud.link("session", number=2)).drop()
    await cloud.link("session", number=3)
    await cloud.link("media", number=2)


async def test_second_agent_does_not_start(cloud, start_agent, place):
    ensure_directory(place / "run", "run_dir")
    with (
        only_one(place / "run" / LOCK),
        pytest.raises(AlreadyRunningError, match="another agent holds"),
    ):
        await start_agent(cloud).task


async def test_unwritable_state_is_told_and_tried_again(cloud, start_agent, place):
    (place / "disk").touch()
    agent = start_agent(cloud, state_dir=str(place / "disk/state"))
    status = await agent.until(lambda status: status.state == "waiting", "waiting")
    assert status.problem_code == "state_unusable"
    assert "set state_dir to a place" in status.advice
    (place / "disk").unlink()
    await agent.until_connected()


async def test_removed_robot_waits_for_its_approval(cloud, agent):
    """A robot whose row was removed finds out why its key is refused, and comes back once approved."""
    cloud.remove_robot()
    cloud.ssh.drop_connections()
    await agent.until(lambda status: status.state == "pending", "pending")
    cloud.approve()
    await agent.until_connected()


async def test_works_on_a_read_only_disk(cloud, start_agent):
    agent = start_agent(cloud)
    await agent.until_connected()
    await agent.stop()
    state = agent.settings.state_dir

    def stamps():
        return {path.name: path.stat().st_mtime_ns for path in [state, *state.iterdir()]}

    before = stamps()
    await start_agent(cloud).until_connected()
    assert stamps() == before


async def test_starts_before_the_network_is_there(cloud, start_agent, place):
    agent = start_agent(cloud, mac="", interface="none0")
    status = await agent.until(lambda status: status.state == "waiting", "waiting")
    assert status.problem_code == "interface_missing"
    kept = {"mac": "00:1b:44:11:3a:b7", "interface": "none0"}
    (place / "state/identity.json").write_text(json.dumps(kept))
    status = await agent.until_connected()
    assert (status.mac, status.interface) == ("00:1b:44:11:3a:b7", "")


async def test_the_server_looks_again_at_a_service_that_came_back(
    cloud, start_agent, services, monkeypatch
):
    """Else the status of an idle robot says for ten minutes that the server finds it down."""
    monkeypatch.setattr("robotether_agent.tunnel.connection.CHECK_PAUSE_S", 0)
    services.refuse_sockets = True
    agent = start_agent(cloud)
    await agent.until(lambda status: status.ros == "down", "rosbridge is down")
    await agent.until_connected()
    session = await cloud.link("session")
    # There is nothing to look at before the configuration opens a tunnel.
    assert session.received.index(session.of_type("check")[0]) > session.received.index(
        session.of_type("ping")[0]
    )
    # What was asked for as the tunnels opened comes before these.
    pings = len(session.of_type("ping"))
    await eventually(lambda: len(session.of_type("ping")) > pings + 3, lambda: "more pings")
    checks = len(session.of_type("check"))
    services.refuse_sockets = False
    await agent.until(lambda status: status.ros == "ok", "rosbridge is back")
    await eventually(lambda: len(session.of_type("check")) > checks, lambda: "another check")
