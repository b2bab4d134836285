"""The numbers in Prometheus' format, without a network."""

import os
import time
from functools import partial
from types import SimpleNamespace

import pytest
from robotether_common.frames import VideoStatus
from robotether_common.session import Battery
from robotether_server.db.fleet import RelayRequest, RelayRobot, Snapshot
from robotether_server.disks import read_space
from robotether_server.relay.channels.rosbridge.bridge import Traffic
from robotether_server.relay.channels.video.feeds import Feed, FeedKey, FeedTraffic
from robotether_server.relay.metrics import (
    Metrics,
    read_backups,
    read_disks,
    read_help_requests,
    read_room,
)
from robotether_server.relay.robots.drive_log import CameraCounts
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.robot import GuardReport, Presence


@pytest.fixture
def traffic():
    return Traffic()


@pytest.fixture
def metrics(traffic):
    return Metrics(traffic)


def lines(metrics):
    return metrics.render().decode().splitlines()


def test_age_of_backups_is_infinite_without_one_and_absent_where_it_is_unknown(metrics, tmp_path):
    """An alarm on a great age also comes where none was ever made."""
    folder = tmp_path / "record"
    metrics.collect(partial(read_backups, folder))
    assert not [line for line in lines(metrics) if line.startswith("robotether_relay_backup")]
    folder.mkdir()
    assert "robotether_relay_backup_age_seconds +Inf" in lines(metrics)
    (folder / "made").write_text(f"{int(time.time()) - 60}\n")
    [age] = [line for line in lines(metrics) if line.startswith("robotether_relay_backup_age")]
    assert float(age.split()[1]) >= 60
    assert "robotether_relay_backup_copy_age_seconds +Inf" in lines(metrics)
    # By a clock that was set back, it would count as new for as long; the others are no times.
    for text in (f"{int(time.time()) + 60}\n", "soon", "9" * 30):
        (folder / "made").write_text(text)
        assert "\nrobotether_relay_backup_age_seconds " not in metrics.render().decode()


def test_refusals_are_counted_from_zero_on(metrics):
    """The first burst is an increase, too."""
    shown = lines(metrics)
    for series in (
        'session_refusals_total{code="preface"}',
        'session_refusals_total{code="robot_unknown"}',
        'guard_refusals_total{kind="fence"}',
        'refusals_total{code="login_missing"}',
        'connections_closed_total{name="client_left"}',
        'port_checks_total{health="down",service="ros"}',
    ):
        assert f"robotether_relay_{series} 0.0" in shown


def test_disks_are_named_and_absent_where_they_are_unknown(metrics, tmp_path):
    database, name = tmp_path / "database", "robotether_relay_disk_free_ratio"
    database.write_text("1 3\n8:1\n")
    metrics.collect(lambda: read_disks(read_space(tmp_path), database, tmp_path))
    metrics.collect(partial(read_room, 0.5))
    shown = {line.rpartition(" ")[0]: line for line in lines(metrics) if line.startswith(name)}
    assert len(shown) == 2
    device = tmp_path.stat().st_dev
    relay = f'device="{os.major(device)}:{os.minor(device)}",volume="relay"'
    assert f"{name}{{{relay}}}" in shown
    assert f'{name}{{device="8:1",volume="database"}} 0.25' in shown.values()
    assert "robotether_relay_recordings_free_ratio 0.5" in lines(metrics)
    os.utime(database, (0, 0))
    (tmp_path / "disk").write_text("     90      10\n")
    shown = lines(metrics)
    assert not [line for line in shown if "database" in line]
    assert f'{name}{{device="",volume="backups"}} 0.9' in shown


def test_requests_for_help_are_counted_and_absent_where_they_are_unknown(metrics):
    states = (("waiting", 40.0), ("offered", 30.0), ("accepted", 90.0))
    requests = [RelayRequest(7, state, age_s, age_s - 20, None, None) for state, age_s in states]
    answers = iter([requests, [], None])
    metrics.collect(partial(read_help_requests, lambda: next(answers)))

    def samples():
        return [line for line in lines(metrics) if line.startswith("robotether_relay_help")]

    prefix = "robotether_relay_help_requests"
    assert samples() == [
        f'{prefix}{{state="waiting"}} 1.0',
        f'{prefix}{{state="offered"}} 1.0',
        f'{prefix}{{state="accepted"}} 1.0',
        "robotether_relay_help_request_age_seconds 90.0",
        "robotether_relay_help_request_waiting_age_seconds 20.0",
    ]
    assert len(samples()) == 3
    assert samples() == []


async def test_robots_are_shown_and_what_is_unknown_of_them_is_not(metrics):
    """A robot that is offline has no old numbers, one that reports nothing has no zeros."""
    registry = SessionRegistry()
    names = {1: "here", 2: "gone", 3: "new", 4: "waits"}
    rows = {
        robot_id: RelayRobot(robot_id, name, "pending" if name == "waits" else "active", 1, 2)
        for robot_id, name in names.items()
    }
    metrics.collect_robots(lambda: Snapshot(rows, {}), registry)
    report = GuardReport(
        "ready", stopped=True, refused=(("old", 3), ("held", 1)), stops=(("lost", 2),)
    )
    registry.ensure_robot(1).presence = Presence(
        online=True, rtt_ms=50.0, battery=Battery(80, False), guard_mode="on", report=report
    )
    registry.ensure_robot(1).slowed_s = 1.5
    registry.ensure_robot(1).camera_counts = CameraCounts(30, 90_000)
    registry.ensure_robot(2).presence = Presence(rtt_ms=70.0, battery=Battery(10, False))
    registry.ensure_robot(3).presence = Presence(online=True)
    for camera, encoder in {"/a": "libx264", "/b": "libx264"}.items():
        watch(registry.ensure_robot(1), camera, encoder)
    watch(registry.ensure_robot(3), "/a", 'a robot may report any text"\n')
    assert [line for line in lines(metrics) if line.startswith("robotether_robot")] == [
        'robotether_robot_up{robot="here",robot_id="1"} 1.0',
        'robotether_robot_up{robot="gone",robot_id="2"} 0.0',
        'robotether_robot_up{robot="new",robot_id="3"} 1.0',
        'robotether_robot_round_trip_seconds{robot="here",robot_id="1"} 0.05',
        'robotether_robot_battery_percent{robot="here",robot_id="1"} 80.0',
        'robotether_robot_stopped{robot="here",robot_id="1"} 1.0',
        'robotether_robot_guard_refusals_total{robot="here",robot_id="1"} 4.0',
        'robotether_robot_guard_stops_total{robot="here",robot_id="1",cause="lost"} 2.0',
        'robotether_robot_slowed_seconds_total{robot="here",robot_id="1"} 1.5',
        'robotether_robot_slowed_seconds_total{robot="new",robot_id="3"} 0.0',
        'robotether_robot_frames_total{robot="here",robot_id="1"} 30.0',
        'robotether_robot_frames_total{robot="new",robot_id="3"} 0.0',
        'robotether_robot_frame_bytes_total{robot="here",robot_id="1"} 90000.0',
        'robotether_robot_frame_bytes_total{robot="new",robot_id="3"} 0.0',
        'robotether_robot_encoder_info{robot="here",robot_id="1",encoder="libx264"} 1.0',
        'robotether_robot_encoder_info{robot="new",robot_id="3",encoder="other"} 1.0',
    ]


def watch(robot, camera, encoder):
    key = FeedKey(camera)
    feed = Feed(SimpleNamespace(id=robot.id), key, FeedTraffic(), robot.camera_counts)
    feed.status = VideoStatus("live", encoder=encoder)
    robot.feeds[key] = feed
