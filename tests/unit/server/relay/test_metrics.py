"""The numbers in Prometheus' format, without a network."""

import time

import pytest
from robotether_server.relay.channels.rosbridge.bridge import Traffic
from robotether_server.relay.channels.video.feeds import CodecTraffic, FeedTraffic
from robotether_server.relay.metrics import Metrics


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
