"""What is on the robot itself, with real services on this machine, and all checks in their order."""

import asyncio
import os
import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import pytest
from fake_root import FakeRoot
from fake_rosbridge import FakeRosbridge
from local_network import free_port
from robotether_agent import rosbridge as rosbridge_module
from robotether_agent.doctor import FAIL, OK, SKIPPED, WARNING, checks, encoder
from robotether_agent.doctor.checks import run_checks
from robotether_agent.enrolment.keys import ensure_key
from robotether_agent.exposure import PAST_GUARD
from robotether_agent.problems import ServerKeyChangedError
from robotether_agent.settings import Settings
from robotether_agent.status import render
from robotether_agent.video.encoder import VideoEncoder

MAC = "00:1b:44:11:3a:b7"


@pytest.fixture
def settings(place, services):
    return Settings(
        server="a.example",
        state_dir=place,
        rosbridge_url=services.ws_url,
        video_url=services.url,
    )


def disk(**changes):
    room = {"f_flag": 0, "f_bavail": 10**6, "f_frsize": 4096, "f_favail": 10**5, "f_files": 10**6}
    return SimpleNamespace(**{**room, **changes})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"f_flag": os.ST_RDONLY}, "is read-only"),
        ({"f_bavail": 100}, "has 0 MB left"),
        ({"f_favail": 0}, "the disk has no inode left"),
    ],
)
def test_a_disk_without_room(settings, tmp_path, monkeypatch, changes, words):
    """The run directory counts, too: without a file there nobody drives, and the status is old."""
    settings = replace(settings, run_dir=tmp_path)
    assert checks.check_disk(settings).state == OK
    for full in (settings.state_dir, settings.run_dir):
        monkeypatch.setattr(
            os, "statvfs", lambda at, full=full: disk(**changes if at == full else {})
        )
        found = checks.check_disk(settings)
        assert found.state == FAIL
        assert f"{full} {words}" in found.detail.replace(":", "")


def test_which_mac_names_the_robot(settings, tmp_path):
    root = FakeRoot(tmp_path)
    none = checks.check_mac(settings, root.path)
    assert (none.state, "set interface or mac" in none.advice) == (FAIL, True)
    root.add("eth0", MAC, 2)
    assert checks.check_mac(settings, root.path).detail == f"{MAC} (eth0)"
    assert list(settings.state_dir.iterdir()) == []
    of_settings = checks.check_mac(replace(settings, mac="00:1b:44:00:00:01"), root.path)
    assert of_settings.detail == "00:1b:44:00:00:01 (set in agent.toml)"


def test_a_mac_that_is_gone(settings, tmp_path):
    root = FakeRoot(tmp_path)
    (settings.state_dir / "identity.json").write_text(f'{{"mac": "{MAC}", "interface": "eth0"}}')
    found = checks.check_mac(settings, root.path)
    assert found.state == FAIL
    assert "(eth0 had it)" in found.detail
    assert "robotether-agent forget" in found.advice


async def test_the_key(settings):
    assert (await checks.check_key(settings)).state == FAIL
    assert list(settings.state_dir.iterdir()) == []
    key = await ensure_key(settings.state_dir)
    assert (await checks.check_key(settings)).detail == key.fingerprint
    key.path.chmod(0o644)
    found = await checks.check_key(settings)
    assert (found.state, "others can read" in found.detail) == (FAIL, True)
    assert key.path.stat().st_mode & 0o777 == 0o644
    key.path.chmod(0o600)
    key.path.with_suffix(".pub").unlink()
    key.path.write_text("rubbish")
    assert (await checks.check_key(settings)).state == FAIL


async def test_the_robots_services(settings, services, monkeypatch):
    with monkeypatch.context() as exposed:
        exposed.setattr(checks, "exposed_at", lambda _url: "0.0.0.0")
        past_guard = await checks.check_rosbridge(settings)
        assert (past_guard.state, PAST_GUARD in past_guard.detail) == (WARNING, True)
    assert (await checks.check_rosbridge(settings)).state == OK
    assert (await checks.check_video(settings)).state == OK
    services.video_status = 503
    unwell = await checks.check_video(settings)
    assert (unwell.state, "HTTP status 503" in unwell.detail) == (FAIL, True)
    services.refuse_sockets = True
    assert "not with a WebSocket" in (await checks.check_rosbridge(settings)).detail
    gone = f"127.0.0.1:{free_port()}"
    away = replace(settings, rosbridge_url=f"ws://{gone}", video_url=f"http://{gone}")
    rosbridge, video = await checks.check_rosbridge(away), await checks.check_video(away)
    assert "Connection refused" in rosbridge.detail
    assert "ros2 launch" in rosbridge.advice
    assert (rosbridge.state, video.state) == (FAIL, SKIPPED)
    assert "a robot without a camera needs none" in video.detail
    elsewhere = await checks.check_video(replace(away, video_source="rosbridge"))
    assert (elsewhere.state, "rosbridge" in elsewhere.detail) == (SKIPPED, True)


# What rosbridge answers where it does not find rosapi.
NOT_FOUND = "Service /rosapi/topics does not exist"


@pytest.mark.parametrize(
    ("robot", "state", "detail"),
    [
        ({"topics": {}}, OK, "answers"),
        ({"topics": {}, "call_services_in_new_thread": True}, OK, "answers"),
        ({"topics": {}, "call_services_in_new_thread": False}, WARNING, "_in_new_thread false"),
        ({"topics": None}, WARNING, "is silent"),
        ({"topics": {}, "answer": NOT_FOUND}, WARNING, "roscore has restarted"),
    ],
)
async def test_rosapi_is_asked(settings, monkeypatch, robot, state, detail):
    if robot["topics"] is None:
        monkeypatch.setattr(rosbridge_module, "ANSWER_WITHIN_S", 0.5)
    answer = robot.pop("answer", None)
    async with FakeRosbridge(**robot) as rosbridge:
        if answer is not None:
            rosbridge._look_up = lambda _: answer
        checked = await checks.check_rosapi(replace(settings, rosbridge_url=rosbridge.url))
    assert checked.state == state
    assert detail in checked.detail
    gone = replace(settings, rosbridge_url=f"ws://127.0.0.1:{free_port()}")
    assert (await checks.check_rosapi(gone)).state == SKIPPED


async def test_the_robots_own_ssh_server(settings):

    async def greet(_, writer):
        writer.write(greeting)
        writer.close()

    async with await asyncio.start_server(greet, "127.0.0.1", 0) as listening:
        address = f"127.0.0.1:{listening.sockets[0].getsockname()[1]}"
        there = replace(settings, shell_address=address)
        greeting = b"SSH-2.0-OpenSSH_9.2\r\n"
        assert (await checks.check_shell(there)).state == OK
        greeting = b"x" * 100_000
        assert "not an SSH server" in (await checks.check_shell(there)).detail
    for none in ("", address):
        assert (await checks.check_shell(replace(settings, shell_address=none))).state == SKIPPED


@pytest.mark.parametrize(
    ("setting", "changes", "state", "reason"),
    [
        ("off", {}, SKIPPED, "video_encoder is off"),
        ("auto", {"os.sched_getaffinity": {0}}, SKIPPED, "one processor core"),
        ("auto", {"robotether_agent.video.encoder.has_pyav": False}, SKIPPED, "PyAV is not inst"),
        ("auto", {}, WARNING, "the encoder ended: exit code 3"),
    ],
)
async def test_robot_without_an_encoder_is_told_why(monkeypatch, setting, changes, state, reason):
    for name, value in {"os.sched_getaffinity": {0, 1}, **changes}.items():
        monkeypatch.setattr(name, lambda *_, value=value: value)
    command = (sys.executable, "-c", "raise SystemExit(3)")
    monkeypatch.setattr(encoder, "VideoEncoder", lambda *how: VideoEncoder(*how, command))
    finding = await encoder.check_encoder(Settings(server="a.example", video_encoder=setting))
    assert finding.state == state
    assert "so video is JPEG" in finding.detail
    assert reason in finding.detail


@pytest.fixture(autouse=True)
def no_systemd(monkeypatch, place):
    monkeypatch.setattr("robotether_agent.systemd.state", lambda: None)


async def test_a_robot_that_works(cloud, start_agent, monkeypatch):
    monkeypatch.setattr("robotether_agent.rosbridge.ANSWER_WITHIN_S", 0.2)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1})
    cloud.checked["video"] = "ok"
    agent = start_agent(cloud, guard="on", shell_address="none")
    await agent.until(
        lambda status: status.end_to_end_ros == "ok" and status.guard == "ready",
        "the server has looked",
    )
    found = [finding async for finding in run_checks(agent.settings)]
    assert len({f.step for f in found}) == 20
    assert [(f.step, f.state) for f in found if f.state != OK] == [
        ("rosapi", WARNING),
        ("shell", SKIPPED),
    ]


@pytest.fixture
def run(place, monkeypatch):
    monkeypatch.setattr("robotether_agent.rosbridge.ANSWER_WITHIN_S", 0.2)

    async def run(**changes):
        settings = Settings(state_dir=place, run_dir=place, mac="00:1b:44:11:3a:b7", **changes)
        return {finding.step: finding async for finding in run_checks(settings)}

    return run


@pytest.mark.parametrize(
    ("changes", "step", "words"),
    [
        ({"server": "no-such-host.invalid"}, "name", "name service"),
        ({"server": "a.example", "http_proxy": "http://127.0.0.1:1"}, "https port", "http_proxy"),
    ],
)
async def test_a_cause_is_said_once_with_its_own_advice(run, changes, step, words):
    """A broken name service and a dead proxy are nothing that the server's firewall could mend."""
    found = await run(**changes, ssh_ports=(2222, 443), ssh_host=changes["server"])
    assert found[step].state == FAIL
    assert words in found[step].advice
    reason = found[step].detail.rpartition(": ")[2]
    assert [name for name, finding in found.items() if reason in finding.detail] == [step]
    assert not any("firewall" in finding.advice for finding in found.values())
    assert all(finding.advice for finding in found.values() if finding.state == FAIL)


async def test_after_another_host_key_doctor_status_and_log_agree(cloud, start_agent, monkeypatch):
    monkeypatch.setattr("robotether_agent.rosbridge.ANSWER_WITHIN_S", 0.2)
    agent = start_agent(cloud, shell_address="none")
    await agent.until_connected()
    cloud.ssh.stop()
    cloud.ssh.new_host_key()
    cloud.ssh.start()
    with pytest.raises(ServerKeyChangedError) as ended:
        await asyncio.wait_for(agent.task, 30)
    shown = render(agent.status(), time.time())
    found = {f.step: f async for f in run_checks(agent.settings)}
    ssh = found[f"ssh {cloud.ssh.port}"]
    for text in (str(ended.value), shown, str(ssh)):
        assert "its host key is not one of those pinned at the first join" in text
        assert "SOMEBODY MAY BE POSING AS THE SERVER" in text
        assert "remove" in text
    assert "stopped" in shown
    assert found["service"].advice.endswith("then: sudo systemctl start robotether-agent")
    assert found["service"].detail == "the agent has stopped for that [host_key_changed]"
    assert cloud.joins[-1]["host_key_refused"] is True
