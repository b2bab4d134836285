"""A machine that forgets who it is becomes a robot of its own at its next start."""

import asyncio
import json
import resource
import threading
from contextlib import contextmanager
from dataclasses import replace

import pytest
from aiohttp import web
from fake_cloud import agent_environ
from fake_root import FakeRoot
from robotether_agent.enrolment.enroller import (
    AUDIT_HEADS_FILE,
    FILES,
    Enroller,
    enrolment_files,
    unenrol,
)
from robotether_agent.enrolment.keys import ensure_next_key
from robotether_agent.fields import ListedCell
from robotether_agent.problems import (
    JoinRefusedError,
    KeyUnusableError,
    ServerUnreachableError,
    StateUnusableError,
)
from robotether_agent.settings import load
from robotether_common.join import JOIN_NAMESPACE, join_message
from robotether_server.signatures import is_signed

CARD = "00:1b:44:00:00:01"


@contextmanager
def full_disk():
    """Let this process write into no file, as on a full disk, even as root.

    The fake cloud lives in the same process: in its mode refuses_key its join writes none.
    """
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture
def settings(cloud, place):
    return load(None, agent_environ(cloud, place))


def renamed(cloud):
    body = {**json.loads(cloud.active().body), "robot": "turtle"}
    return lambda: web.json_response(body)


def refuses_tokens(cloud, status, code):
    refusal = {"code": code, "detail": "this token is of no use"}

    def answer():
        if "token" in cloud.joins[-1]:
            return web.json_response(refusal, status=status)
        return cloud.active()

    return answer


async def enrol(settings):
    enroller = Enroller(settings)
    await enroller.enrolment()
    enroller.doubt()
    return enroller


async def test_a_fresh_robot_joins_and_a_reboot_does_not(cloud, settings):
    enroller = Enroller(settings)
    key = await enroller.key()
    enrolment = await enroller.enrolment()
    assert (enrolment.robot, enrolment.mac) == ("sim1", "00:1b:44:11:3a:b7")
    assert enrolment.ssh.ports == (cloud.ssh.port,)
    assert settings.state_dir.stat().st_mode & 0o777 == 0o700
    assert cloud.joins[0]["public_key"] == key.public
    assert cloud.ssh.host_keys[0].split()[1] in enroller.known_hosts.read_text()
    assert await Enroller(settings).enrolment() == enrolment
    assert len(cloud.joins) == 1


@pytest.mark.parametrize("token", [None, "rj_token"])
async def test_join_proves_the_key(cloud, settings, token):
    await Enroller(replace(settings, token=token)).enrolment()
    said = cloud.joins[0]
    message = join_message(token, said["mac"], said["public_key"])
    assert is_signed(said["public_key"], JOIN_NAMESPACE, message, said["signature"])


async def test_a_doubt_asks_until_the_server_answered(cloud, settings):
    enroller = await enrol(settings)
    await enroller.key()
    cloud.answer = lambda: web.Response(status=502)
    assert (await enroller.enrolment()).robot == "sim1"
    cloud.answer = renamed(cloud)
    assert (await enroller.enrolment()).robot == "turtle"
    assert (await Enroller(settings).enrolment()).robot == "turtle"
    await enroller.enrolment()
    assert len(cloud.joins) == 3


async def test_a_web_that_says_nothing_holds_up_no_enrolled_robot(cloud, settings, monkeypatch):
    monkeypatch.setattr("robotether_agent.enrolment.enroller.QUICK_ANSWER_S", 0.2)
    enroller = Enroller(settings)
    known = await enroller.enrolment()

    async def say_nothing(*_):
        await asyncio.Event().wait()
        raise AssertionError("nothing sets it")

    enroller.doubt()
    with monkeypatch.context() as silent:
        silent.setattr("robotether_agent.enrolment.enroller.join", say_nothing)
        assert await asyncio.wait_for(enroller.enrolment(), 5) == known
    joins = len(cloud.joins)
    assert await enroller.enrolment() == known
    assert len(cloud.joins) == joins


async def test_a_token_that_is_gone_keeps_no_enrolled_robot_out(cloud, settings, place):
    (place / "token").write_text("rt_abc\n")
    enroller = await enrol(replace(settings, token_file=place / "token"))
    (place / "token").unlink()
    assert (await enroller.enrolment()).robot == "sim1"
    assert "token" not in cloud.joins[-1]


@pytest.mark.parametrize(("status", "code"), [(401, "token_used_up"), (403, "grant_missing")])
async def test_a_token_that_is_worthless_keeps_no_enrolled_robot_out(cloud, settings, status, code):
    settings = replace(settings, token="rt_old")
    enroller = await enrol(settings)
    cloud.answer = refuses_tokens(cloud, status, code)
    assert (await enroller.enrolment()).robot == "sim1"
    assert ["token" in said for said in cloud.joins] == [True, True, False]


async def test_a_worthless_token_keeps_a_fresh_robot_out(cloud, settings):
    """Who gave a robot a token is told that it is no use, not left with a robot that waits."""
    cloud.answer = refuses_tokens(cloud, 401, "token_invalid")
    with pytest.raises(JoinRefusedError, match="this token is of no use"):
        await enrol(replace(settings, token="rt_old"))
    assert len(cloud.joins) == 1


async def test_a_fresh_robot_needs_a_disk(cloud, settings):
    """Host keys that cannot be pinned are trusted not even once."""
    cloud.mode = "refuses_key"
    enroller = Enroller(settings)
    await enroller.key()
    with full_disk(), pytest.raises(StateUnusableError, match=r"cannot write .*known_hosts"):
        await enroller.enrolment()


async def test_another_server_in_the_settings_is_joined_and_pinned(cloud, settings, caplog):
    await enrol(settings)
    cloud.ssh.new_host_key()
    moved = replace(settings, server=settings.server.replace("127.0.0.1", "localhost"))
    enroller = Enroller(moved)
    assert (await enroller.enrolment()).server == moved.server
    assert f"another server now, {moved.server}" in caplog.text
    assert pins(enroller.known_hosts) == {cloud.ssh.host_keys[0].split()[1]}


@pytest.fixture
def machine(tmp_path):
    made = FakeRoot(tmp_path)
    made.add("eth0", CARD, 2)
    return made


async def without_its_card(settings, machine):
    await Enroller(settings, machine.path).enrolment()
    machine.remove("eth0")
    machine.add("eth0", "00:1b:44:00:00:02", 2)
    return Enroller(settings, machine.path)


async def test_a_robot_without_its_mac_asks_first_and_says_so_once(
    cloud, settings, machine, caplog
):
    """The server tells a new card from a copied disk; from then on the robot connects as ever."""
    settings = replace(settings, mac=None)
    enroller = await without_its_card(settings, machine)
    assert (await enroller.enrolment()).mac == CARD
    await enroller.enrolment()
    assert [said.get("mac_present", True) for said in cloud.joins] == [True, False]
    assert {said["mac"] for said in cloud.joins} == {CARD}
    assert caplog.text.count(f"no interface of this machine has the MAC {CARD} (eth0 had it)") == 1


async def test_a_robot_without_its_mac_does_not_guess(cloud, settings, machine):
    enroller = await without_its_card(replace(settings, mac=None), machine)
    await cloud.stop_web()
    with pytest.raises(ServerUnreachableError):
        await enroller.enrolment()


async def test_a_new_mac_in_the_settings_is_asked_about(cloud, settings):
    await enrol(settings)
    moved = replace(settings, mac="00:1b:44:00:00:09")
    assert (await Enroller(moved).enrolment()).mac == "00:1b:44:00:00:09"
    assert len(cloud.joins) == 2


async def test_an_answer_that_was_lost_is_asked_for_again(cloud, settings):
    """When the agent dies after the server took the key, the next start brings the change to its end."""
    enroller = await enrol(settings)
    cloud.mode = "loses_answers"
    with pytest.raises(ServerUnreachableError):
        await enroller.rotate()
    coming = await enroller.next_key()
    assert cloud.robot_key == coming.public
    cloud.mode = "serves"
    started_anew = Enroller(settings)
    await started_anew.enrolment()
    assert (await started_anew.key()).public == coming.public


async def test_a_slow_disk_does_not_silence_the_agent(cloud, settings, monkeypatch):
    """A memory card takes seconds for a sync, and the guard stops a robot whose agent is silent for one."""
    enroller = await enrol(settings)
    threads = []
    monkeypatch.setattr("os.fsync", lambda _: threads.append(threading.get_ident()))
    await enroller.rotate()
    enroller.follow("sim1", (ListedCell("b.example", (2222,)),))
    assert len(cloud.joins) == 2
    assert len(threads) == 3
    assert threading.get_ident() not in threads


async def test_a_disk_that_takes_no_new_key_keeps_the_old_one(cloud, settings):
    """Nothing is asked of the server before the new key is safe on the disk."""
    enroller = await enrol(settings)
    old = await enroller.key()
    with full_disk(), pytest.raises((KeyUnusableError, StateUnusableError)):
        await enroller.rotate()
    assert len(cloud.joins) == 1
    assert await enroller.key() == old


def rejected():
    refusal = {"code": "key_rejected", "detail": "this key was rejected"}
    return web.json_response(refusal, status=403)


async def test_a_key_that_an_admin_rejected_is_given_up(cloud, settings):
    enroller = await enrol(settings)
    cloud.refuses_rotation = rejected
    with pytest.raises(JoinRefusedError, match="rejected"):
        await enroller.rotate()
    assert await enroller.next_key() is None
    assert (await enroller.enrolment()).robot == "sim1"


def pins(known_hosts):
    return {line.split()[2] for line in known_hosts.read_text().splitlines()}


@pytest.fixture
async def enrolled(make_cloud, place):
    made = load(None, agent_environ(await make_cloud(), place, mac="", interface="lo"))
    (place / "state").mkdir()
    (place / "state/identity.json").write_text('{"mac": "00:1b:44:11:3a:b7", "interface": "lo"}')
    await Enroller(made).enrolment()
    await ensure_next_key(made.state_dir)
    (made.state_dir / AUDIT_HEADS_FILE).write_text("{}")
    return made


def test_nothing_that_names_the_robot_stays(enrolled):
    """Key, next key, enrolment, pinned host keys and MAC are gone, and nothing else ever was there."""
    assert {path.name for path in enrolled.state_dir.iterdir()} == set(FILES)
    unenrol(enrolled)
    assert list(enrolled.state_dir.iterdir()) == []
    assert enrolment_files(enrolled.state_dir) == []
