"""The numbers in Prometheus' format, without a network."""

import time

import pytest
from prometheus_client.parser import text_string_to_metric_families
from robotether_common.session import Battery
from robotether_server.db.fleet import RelayRequest, RelayRobot, Snapshot
from robotether_server.relay.channels.rosbridge.bridge import Traffic
from robotether_server.relay.channels.video.feeds import CodecTraffic, FeedTraffic
from robotether_server.relay.metrics import SAMPLES_IN_PART, Metrics
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


def test_frames_are_read_when_somebody_asks(metrics):
    traffic = FeedTraffic()
    metrics.collect_feeds(traffic)
    traffic.by_codec["h264"], traffic.skipped = CodecTraffic(3, 300, 7, 700), 2
    shown = lines(metrics)
    assert 'robotether_relay_frames_total{codec="h264",to="relay"} 3.0' in shown
    assert 'robotether_relay_frames_total{codec="h264",to="client"} 7.0' in shown
    assert 'robotether_relay_frame_bytes_total{codec="h264",to="relay"} 300.0' in shown
    assert 'robotether_relay_frame_bytes_total{codec="h264",to="client"} 700.0' in shown
    assert 'robotether_relay_frames_total{codec="jpeg",to="relay"} 0.0' in shown
    assert "robotether_relay_frames_skipped_total 2.0" in shown


def test_age_of_backups_is_infinite_without_one_and_absent_where_it_is_unknown(metrics, tmp_path):
    """An alarm on a great age also comes where none was ever made."""
    folder = tmp_path / "record"
    metrics.collect_backups(folder)
    assert not [line for line in lines(metrics) if line.startswith("robotether_relay_backup")]
    folder.mkdir()
    assert "robotether_relay_backup_age_seconds +Inf" in lines(metrics)
    (folder / "made").write_text(f"{int(time.time()) - 60}\n")
    [age] = [line for line in lines(metrics) if line.startswith("robotether_relay_backup_age")]
    assert float(age.split()[1]) >= 60
    assert "robotether_relay_backup_copy_age_seconds +Inf" in lines(metrics)


def test_requests_for_help_are_counted_and_absent_where_they_are_unknown(metrics):
    requests = [
        RelayRequest(7, "waiting", age_s=4.0, user=None, left_s=None),
        RelayRequest(8, "waiting", age_s=90.0, user=None, left_s=None),
    ]
    answers = iter([requests, [], None])
    metrics.collect_help_requests(lambda: next(answers))

    def samples():
        return [line for line in lines(metrics) if line.startswith("robotether_relay_help")]

    prefix = "robotether_relay_help_requests"
    assert samples() == [
        f'{prefix}{{state="waiting"}} 2.0',
        f'{prefix}{{state="offered"}} 0.0',
        f'{prefix}{{state="accepted"}} 0.0',
        "robotether_relay_help_request_age_seconds 90.0",
    ]
    assert len(samples()) == 3
    assert samples() == []


def test_times_are_counted_by_the_bounds_that_alerts_use(metrics, traffic):
    for age_s in (0.2, 0.21, 7.0):
        traffic.command_ages.add(age_s)
    metrics.count_seen([100.0, None, 250.0])
    shown = lines(metrics)
    prefix = "robotether_relay_command_age_seconds"
    assert f'{prefix}_bucket{{le="0.1"}} 0.0' in shown
    assert f'{prefix}_bucket{{le="0.2"}} 1.0' in shown
    assert f'{prefix}_bucket{{le="1.0"}} 2.0' in shown
    assert f'{prefix}_bucket{{le="+Inf"}} 3.0' in shown
    assert f"{prefix}_sum 7.41" in shown
    assert 'robotether_relay_seen_age_seconds_bucket{le="0.2"} 1.0' in shown
    assert "robotether_relay_seen_age_seconds_count 2.0" in shown
    assert "robotether_relay_seen_age_unknown_total 1.0" in shown


def test_robots_are_shown_and_what_is_unknown_of_them_is_not(metrics):
    """A robot that is offline has no old numbers, one that reports nothing has no zeros."""
    registry = SessionRegistry()
    names = {1: "here", 2: "gone", 3: "new", 4: "waits"}
    rows = {
        robot_id: RelayRobot(robot_id, name, "pending" if name == "waits" else "active", 1, 2)
        for robot_id, name in names.items()
    }
    metrics.collect_robots(lambda: Snapshot(rows, {}), registry)
    report = GuardReport("ready", stopped=True, refused=(("old", 3),))
    registry.ensure_robot(1).presence = Presence(
        online=True, rtt_ms=50.0, battery=Battery(80, False), guard_mode="on", report=report
    )
    registry.ensure_robot(1).slowed_s = 1.5
    registry.ensure_robot(2).presence = Presence(rtt_ms=70.0, battery=Battery(10, False))
    registry.ensure_robot(3).presence = Presence(online=True)
    assert [line for line in lines(metrics) if line.startswith("robotether_robot")] == [
        'robotether_robot_up{robot="here"} 1.0',
        'robotether_robot_up{robot="gone"} 0.0',
        'robotether_robot_up{robot="new"} 1.0',
        'robotether_robot_round_trip_seconds{robot="here"} 0.05',
        'robotether_robot_battery_percent{robot="here"} 80.0',
        'robotether_robot_stopped{robot="here"} 1.0',
        'robotether_robot_guard_refusals_total{kind="old",robot="here"} 3.0',
        'robotether_robot_slowed_seconds_total{robot="here"} 1.5',
        'robotether_robot_slowed_seconds_total{robot="new"} 0.0',
    ]


def test_a_large_family_is_written_in_parts_that_make_one(metrics):
    count = 2 * SAMPLES_IN_PART + 1
    rows = {number: RelayRobot(number, f"r{number}", "active", 1, 2) for number in range(count)}
    metrics.collect_robots(lambda: Snapshot(rows, {}), SessionRegistry())
    parts = [part for part in metrics.parts() if b"robot_up" in part]
    assert [part.count(b"\nrobotether_robot_up{") for part in parts[:1]] == [SAMPLES_IN_PART]
    [family] = [
        family
        for family in text_string_to_metric_families(metrics.render().decode())
        if family.name == "robotether_robot_up"
    ]
    assert len(family.samples) == count
