"""All checks of a robot that works, and of one where nothing does."""

from __future__ import annotations

import pytest
from robotether_agent.doctor import FAIL, OK, SKIPPED, WARNING, fail, ok, skipped
from robotether_agent.doctor.checks import run_checks
from robotether_agent.settings import Settings

STEPS = ["settings", "disk", "mac", "key", "name", "https port", "certificate", "clock", "answer"]
LAST_STEPS = [
    "service",
    "rosbridge",
    "rosapi",
    "guard",
    "video",
    "shell",
    "connection",
    "end to end",
]


@pytest.fixture(autouse=True)
def no_systemd(monkeypatch, place):
    """This machine's own boot services are not the robot's."""
    monkeypatch.setattr("robotether_agent.systemd.state", lambda: None)


async def test_a_robot_that_works(make_cloud, start_agent, monkeypatch):
    """While the agent runs every step is well, in the order of a connection; the double has no rosapi."""
    monkeypatch.setattr("robotether_agent.rosbridge.ANSWER_WITHIN_S", 0.2)
    cloud = await make_cloud()
    cloud.checked["video"] = "ok"
    agent = start_agent(cloud, shell_address="none")
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


async def test_a_machine_where_nothing_works_yet(place):
    """Each step is still looked at, and each FAIL says what to do."""
    settings = Settings(
        server="no-such-host.invalid", state_dir=place / "state", run_dir=place / "run"
    )
    found = [finding async for finding in run_checks(settings)]
    failed = [finding for finding in found if finding.state == FAIL]
    assert {"disk", "key", "name", "join", "service"} <= {finding.step for finding in failed}
    assert all(finding.advice for finding in failed)


def test_one_line_a_step_and_the_advice_below_a_fail():
    """A person reads down the first column and finds what to do beside the first FAIL."""
    assert str(ok("clock", "it is right")) == "ok       clock        it is right"
    assert str(skipped("answer", "no connection")) == "skipped  answer       no connection"
    assert str(fail("disk", "it is full", "make room")).splitlines() == [
        "FAIL     disk         it is full",
        "                      what to do: make room",
    ]
