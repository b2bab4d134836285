"""The numbers in Prometheus' format, without a network."""

import time

import pytest
from robotether_server.relay.channels.rosbridge.bridge import Traffic
from robotether_server.relay.channels.video.feeds import FeedTraffic
from robotether_server.relay.metrics import Metrics


@pytest.fixture
def traffic():
    return Traffic()


@pytest.fixture
def metrics(traffic):
    return Metrics(traffic)


def lines(metrics):
    return metrics.render().decode().splitlines()


def test_traffic_is_read_when_somebody_asks(metrics, traffic):
    """Integers that bridges raise show up in the next answer, each under its direction."""
    assert 'robotether_relay_messages_total{to="robot"} 0.0' in lines(metrics)
    traffic.messages_to_robot, traffic.messages_to_client = 1, 2
    traffic.bytes_to_robot, traffic.bytes_to_client = 30, 40
    traffic.refused["topic"] = 5
    shown = lines(metrics)
    assert 'robotether_relay_messages_total{to="robot"} 1.0' in shown
    assert 'robotether_relay_messages_total{to="client"} 2.0' in shown
    assert 'robotether_relay_message_bytes_total{to="robot"} 30.0' in shown
    assert 'robotether_relay_message_bytes_total{to="client"} 40.0' in shown
    assert 'robotether_relay_messages_refused_total{kind="topic"} 5.0' in shown


def test_a_gauge_is_read_when_somebody_asks(metrics):
    robots = [1, 2]
    metrics.gauge("robots_online", "Robots with a session", lambda: len(robots))
    assert "robotether_relay_robots_online 2.0" in lines(metrics)
    robots.clear()
    assert "robotether_relay_robots_online 0.0" in lines(metrics)


def test_close_reasons_and_refusals_are_counted_by_reason(metrics):
    for _ in range(2):
        metrics.close_reasons.labels("client_left").inc()
    metrics.refusals.labels("ticket_used").inc()
    metrics.session_close_codes.labels("timeout").inc()
    metrics.session_refusals.labels("preface").inc()
    metrics.guard_refusals.labels("old").inc(3)
    metrics.port_checks.labels("ros", "down").inc()
    shown = lines(metrics)
    assert 'robotether_relay_connections_closed_total{name="client_left"} 2.0' in shown
    assert 'robotether_relay_refusals_total{code="ticket_used"} 1.0' in shown
    assert 'robotether_relay_sessions_closed_total{code="timeout"} 1.0' in shown
    assert 'robotether_relay_session_refusals_total{code="preface"} 1.0' in shown
    assert 'robotether_relay_guard_refusals_total{kind="old"} 3.0' in shown
    assert 'robotether_relay_port_checks_total{health="down",service="ros"} 1.0' in shown


def test_two_relays_do_not_share_their_numbers(metrics, traffic):
    """A second relay in the process begins at zero, and may have gauges of the same names."""
    metrics.refusals.labels("ticket_used").inc()
    other = Metrics(Traffic())
    for each in (metrics, other):
        each.gauge("drivers", "Connections that drive", lambda: 0)
    assert not any("ticket_used" in line for line in lines(other))


def test_frames_are_read_when_somebody_asks(metrics):
    traffic = FeedTraffic()
    metrics.collect_feeds(traffic)
    traffic.frames_in, traffic.frames_out, traffic.skipped = 3, 7, 2
    traffic.bytes_in, traffic.bytes_out = 300, 700
    shown = lines(metrics)
    assert 'robotether_relay_frames_total{to="relay"} 3.0' in shown
    assert 'robotether_relay_frames_total{to="client"} 7.0' in shown
    assert 'robotether_relay_frame_bytes_total{to="relay"} 300.0' in shown
    assert 'robotether_relay_frame_bytes_total{to="client"} 700.0' in shown
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
