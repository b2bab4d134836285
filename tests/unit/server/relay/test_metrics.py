"""The numbers in Prometheus' format, without a network."""

import time

import pytest
from robotether_server.db.fleet import RelayRequest
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
