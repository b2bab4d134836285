"""All checks of a robot that works, and of one where nothing does."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest
from robotether_agent.doctor import FAIL, OK, SKIPPED, WARNING, Finding
from robotether_agent.doctor.checks import run_checks
from robotether_agent.problems import ServerKeyChangedError
from robotether_agent.settings import Settings
from robotether_agent.status import render

STEPS = ["settings", "disk", "mac", "key", "name", "https port", "certificate", "clock", "answer"]
LAST_STEPS = [
    "service",
    "rosbridge",
    "rosapi",
    "guard",
    "video",
    "encoder",
    "shell",
    "connection",
    "end to end",
]


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
    assert [f.step for f in found] == [*STEPS, "join", f"ssh {cloud.ssh.port}", *LAST_STEPS]
    assert [(f.step, f.state) for f in found if f.state != OK] == [
        ("rosapi", WARNING),
        ("shell", SKIPPED),
    ]


@pytest.fixture
def run(place, monkeypatch):
    monkeypatch.setattr("robotether_agent.rosbridge.ANSWER_WITHIN_S", 0.2)

    async def run(**changes: Any) -> dict[str, Finding]:
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
