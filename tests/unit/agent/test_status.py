"""The status file, and what a person reads from it."""

from dataclasses import replace

from robotether_agent.exposure import PAST_GUARD
from robotether_agent.problems import KeyRefusedError
from robotether_agent.status import (
    STALE_S,
    Status,
    StatusWriter,
    has_problem,
    headline,
    is_alive,
    read_status,
    render,
)

NOW = 1_700_000_000.0
UP = Status(
    state="connected",
    since=NOW - 60,
    server="robots.example.com",
    robot="sim1",
    mac="00:1b:44:11:3a:b7",
    interface="eth0",
    fingerprint="SHA256:abc",
    ssh="b.example.com port 443",
    rtt_ms=12.34,
    guard="ready",
    ros="ok",
    video="down",
    video_detail="web_video_server at http://127.0.0.1:8080 does not answer: Connection refused",
    video_tunnel="open",
    written_at=NOW,
)


def test_what_is_not_safe_has_its_line():
    """The installer and the playbook print the second one."""
    unsafe = {"ros_exposed": "192.0.2.1", "ros_exposed_advice": "close it"}
    lines = render(replace(UP, stopped_by="ben", **unsafe), NOW).splitlines()
    assert "STOPPED       by ben; a driver releases it on its page" in lines
    assert f"warning       rosbridge answers at 192.0.2.1: {PAST_GUARD}; close it" in lines


def test_reads_the_file_of_an_earlier_agent(place):
    """`switch` asks the version that it replaces, whose file lacks what came since."""
    (place / "status.json").write_text('{"state": "connected", "robot": "sim1", "written_at": 5.0}')
    found = read_status(place)
    assert (found.state, found.robot, found.guard) == ("connected", "sim1", "unknown")


def writer_by(place, clock, uptime):
    return StatusWriter(
        place, "a.example", on_state=lambda _: None, clock=lambda: clock[0], uptime=uptime
    )


def test_times_follow_a_clock_that_is_set(place):
    """A robot's clock without a battery says long ago until it has the network's time."""
    clock, uptime = [5000.0], [10.0]
    writer = writer_by(place, clock, lambda: uptime[0])
    writer.report_problem(KeyRefusedError("cannot log in"), "waiting")
    clock[0], uptime[0] = NOW + 30, 40.0
    writer.refresh()
    status = writer.status
    assert (status.since, status.problem_at, status.problem_over_at) == (NOW, NOW, 0.0)
    assert status.written_at == NOW + 30


def test_a_problem_that_is_over(place):
    clock = [NOW]
    writer = writer_by(place, clock, lambda: clock[0] - NOW)
    writer.set(state="connected", robot="sim1", video_tunnel="open")
    writer.report_problem(
        KeyRefusedError("cannot log in", advice="approve it"), "waiting", video_tunnel="closed"
    )
    writer.set(state="connected")
    assert has_problem(writer.status), "the video tunnel is still closed"
    assert "what to do    approve it" in render(writer.status, NOW)
    clock[0] += 20
    writer.set(video_tunnel="open")
    clock[0] += 60
    writer.set(rtt_ms=3.0)
    assert not has_problem(writer.status)
    assert render(writer.status, clock[0]).splitlines()[-2:] == [
        "problem       none now; the last one was over at 2023-11-14 22:13:40 UTC",
        "              it came at 2023-11-14 22:13:20 UTC: cannot log in [key_refused]",
    ]
    writer.set(state="stopped", video_tunnel="closed")
    assert headline(writer.status) == "stopped"


def test_of_an_agent_that_no_longer_writes_nothing_is_known():
    assert is_alive(UP, NOW + STALE_S - 1)
    assert not is_alive(UP, NOW + STALE_S + 1)
    shown = render(replace(UP, stopped_by="ben"), NOW + 60)
    assert "state         no sign of life since 2023-11-14 22:13:20 UTC; see systemctl" in shown
    # What it said of guard and rosbridge is of then; a stop outlives it.
    assert [word for word in ("guard", "rosbridge", "video", "STOPPED") if word in shown] == [
        "STOPPED"
    ]


def test_no_or_broken_file_is_no_status(place):
    assert read_status(place) is None
    (place / "status.json").write_text('{"state": 7}')
    assert read_status(place) is None
