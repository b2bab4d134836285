"""The enroller against a real join over TLS: when it asks, and what an enrolled robot never needs again."""

from __future__ import annotations

import json
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from aiohttp import web
from fake_cloud import FakeCloud, agent_environ
from robotether_agent.enroller import Enroller
from robotether_agent.problems import (
    InterfaceMissing,
    JoinRefused,
    NotEnrolled,
    ServerUnreachable,
    SettingsInvalid,
    StateUnusable,
)
from robotether_agent.settings import Settings, load


@pytest.fixture
async def cloud(make_cloud) -> FakeCloud:
    """A server that lets the robot in."""
    return await make_cloud()


@pytest.fixture
def settings(cloud, place) -> Settings:
    """A robot in `place` that belongs to the cloud."""
    return load(None, agent_environ(cloud, place))


@contextmanager
def full_disk() -> Iterator[None]:
    """Let this process write into no file, as on a full disk, even as root.

    The fake cloud lives in the same process: in its mode refuses_key its join writes none.
    """
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def renamed(cloud: FakeCloud) -> Callable[[], web.Response]:
    """The server's answer after an admin named the robot turtle."""
    body = {**json.loads(cloud.active().body), "robot": "turtle"}
    return lambda: web.json_response(body)


def refuses_tokens(cloud: FakeCloud, status: int, code: str) -> Callable[[], web.Response]:
    """A server that lets the key in, but only without a token."""
    refusal = {"code": code, "detail": "this token is of no use"}

    def answer() -> web.Response:
        if "token" in cloud.joins[-1]:
            return web.json_response(refusal, status=status)
        return cloud.active()

    return answer


async def enrol(settings: Settings) -> Enroller:
    """Return the enroller of a robot that has joined, and now has a reason to ask again."""
    enroller = Enroller(settings)
    await enroller.enrolment(await enroller.key())
    enroller.doubt()
    return enroller


async def test_a_key_is_made_once_in_a_private_directory(settings):
    """The first start makes the directory, which nobody else may read, and the key that stays."""
    key = await Enroller(settings).key()
    assert settings.state_dir.stat().st_mode & 0o777 == 0o700
    assert await Enroller(settings).key() == key


async def test_a_fresh_robot_joins_and_a_reboot_does_not(cloud, settings):
    """What the join answered is kept with the host keys, so that the next start asks nobody."""
    enroller = Enroller(settings)
    key = await enroller.key()
    enrolment = await enroller.enrolment(key)
    assert (enrolment.robot, enrolment.mac) == ("sim1", "00:1b:44:11:3a:b7")
    assert enrolment.ssh.ports == (cloud.ssh.port,)
    assert cloud.joins[0]["public_key"] == key.public
    assert cloud.ssh.host_keys[0].split()[1] in enroller.known_hosts.read_text()
    assert await Enroller(settings).enrolment(key) == enrolment
    assert len(cloud.joins) == 1


async def test_a_fresh_robot_needs_the_server(cloud, settings):
    """Without an enrolment and without the web there is nothing to connect to."""
    await cloud.stop_web()
    enroller = Enroller(settings)
    with pytest.raises(ServerUnreachable):
        await enroller.enrolment(await enroller.key())


async def test_a_doubt_asks_until_the_server_answered(cloud, settings):
    """A doubt asks before the next connection, and is gone with the answer, which is kept."""
    enroller = await enrol(settings)
    key = await enroller.key()
    cloud.answer = lambda: web.Response(status=502)
    assert (await enroller.enrolment(key)).robot == "sim1"
    cloud.answer = renamed(cloud)
    assert (await enroller.enrolment(key)).robot == "turtle"
    assert (await Enroller(settings).enrolment(key)).robot == "turtle"
    await enroller.enrolment(key)
    assert len(cloud.joins) == 3


async def test_a_refusal_holds_for_an_enrolled_robot_too(cloud, settings):
    """What the server says about this very robot is told, not passed over for what was pinned."""
    enroller = await enrol(settings)
    key = await enroller.key()
    refusal = {"code": "robot_disabled", "detail": "it is disabled"}
    cloud.answer = lambda: web.json_response(refusal, status=403)
    with pytest.raises(JoinRefused, match="it is disabled"):
        await enroller.enrolment(key)
    cloud.remove_robot()
    with pytest.raises(NotEnrolled, match="robotether robot approve"):
        await enroller.enrolment(key)


async def test_a_fresh_robot_shows_its_token(cloud, settings, place):
    """The token goes with the first join; a token file that is missing then is a wrong setting."""
    settings = replace(settings, token_file=place / "token")
    with pytest.raises(SettingsInvalid, match="cannot read the join token"):
        await enrol(settings)
    (place / "token").write_text("rt_abc\n")
    await enrol(settings)
    assert [said["token"] for said in cloud.joins] == ["rt_abc"]


async def test_a_token_that_is_gone_keeps_no_enrolled_robot_out(cloud, settings, place):
    """Once enrolled the token file may be removed: the robot asks again without it."""
    (place / "token").write_text("rt_abc\n")
    enroller = await enrol(replace(settings, token_file=place / "token"))
    (place / "token").unlink()
    assert (await enroller.enrolment(await enroller.key())).robot == "sim1"
    assert "token" not in cloud.joins[-1]


@pytest.mark.parametrize(("status", "code"), [(401, "token_invalid"), (403, "grant_missing")])
async def test_a_token_that_is_worthless_keeps_no_enrolled_robot_out(cloud, settings, status, code):
    """A token that expired since, or whose user is no admin any more, is left out of the next join."""
    settings = replace(settings, token="rt_old")
    enroller = await enrol(settings)
    cloud.answer = refuses_tokens(cloud, status, code)
    assert (await enroller.enrolment(await enroller.key())).robot == "sim1"
    assert ["token" in said for said in cloud.joins] == [True, True, False]


async def test_a_worthless_token_keeps_a_fresh_robot_out(cloud, settings):
    """Who gave a robot a token is told that it is no use, not left with a robot that waits."""
    cloud.answer = refuses_tokens(cloud, 401, "token_invalid")
    with pytest.raises(JoinRefused, match="this token is of no use"):
        await enrol(replace(settings, token="rt_old"))
    assert len(cloud.joins) == 1


async def test_a_ca_file_that_is_gone_keeps_no_enrolled_robot_out(settings, place):
    """An enrolled robot that cannot trust the web any more still has the host keys of SSH."""
    key = await (await enrol(settings)).key()
    enroller = Enroller(replace(settings, tls_fingerprint=None, ca_file=place / "none.pem"))
    enroller.doubt()
    assert (await enroller.enrolment(key)).robot == "sim1"


async def test_a_full_disk_keeps_no_enrolled_robot_out(cloud, settings, caplog):
    """News that cannot be kept are told, and the robot connects with what it knows."""
    enroller = await enrol(settings)
    key = await enroller.key()
    cloud.mode, cloud.answer = "refuses_key", renamed(cloud)
    with full_disk():
        assert (await enroller.enrolment(key)).robot == "sim1"
    assert "neither full nor read-only" in caplog.text
    assert (await enroller.enrolment(key)).robot == "turtle"


async def test_a_fresh_robot_needs_a_disk(cloud, settings):
    """Host keys that cannot be pinned are trusted not even once."""
    cloud.mode = "refuses_key"
    enroller = Enroller(settings)
    key = await enroller.key()
    with full_disk(), pytest.raises(StateUnusable, match=r"cannot write .*known_hosts"):
        await enroller.enrolment(key)


async def test_the_mac_stays_what_it_was_at_the_join(cloud, settings):
    """An adapter that is pulled out later gives an enrolled robot no other name, a fresh one none."""
    pulled = replace(settings, mac=None, interface="none0")
    with pytest.raises(InterfaceMissing, match="no interface none0"):
        await enrol(pulled)
    assert cloud.joins == []
    key = await (await enrol(settings)).key()
    enroller = Enroller(pulled)
    enroller.doubt()
    assert (await enroller.enrolment(key)).mac == "00:1b:44:11:3a:b7"
    assert cloud.joins[-1]["mac"] == "00:1b:44:11:3a:b7"


async def test_another_server_in_the_settings_is_joined_and_pinned(cloud, settings, caplog):
    """A robot that is given to another server joins there with its old key, and says what it pins."""
    key = await (await enrol(settings)).key()
    cloud.ssh.new_host_key()
    moved = replace(settings, server=settings.server.replace("127.0.0.1", "localhost"))
    enroller = Enroller(moved)
    assert (await enroller.enrolment(key)).server == moved.server
    assert f"another server now, {moved.server}" in caplog.text
    assert pins(enroller.known_hosts) == {cloud.ssh.host_keys[0].split()[1]}


def pins(known_hosts: Path) -> set[str]:
    """Return the host keys that OpenSSH trusts."""
    return {line.split()[2] for line in known_hosts.read_text().splitlines()}
