"""What becomes of the answers of Prometheus; one that answers is a web server of the tests."""

import json
from contextlib import contextmanager

import pytest
import tls_web
from robotether_server.problems import HistoryUnavailableError
from robotether_server.services import history
from robotether_server.services.history import (
    CHARTS_OF_ROBOT,
    SPANS,
    Line,
    Prometheus,
    query_of,
)

NOW_S = 1_800_000_030.0
END_S = 1_800_000_000


@contextmanager
def answering(answer, status="200 OK"):
    """A Prometheus that answers so."""

    def answers(_environ, respond):
        respond(status, [("Content-Length", str(len(answer)))])
        return [answer]

    with tls_web.running(answers) as web:
        host, port = web.address.split(":")
        yield Prometheus((host, int(port)))


def result(*series):
    return json.dumps({"status": "success", "data": {"result": series}}).encode()


def test_what_prometheus_does_not_know_is_none_and_in_its_place():
    values = [[END_S - 3600, "1"], [END_S - 120, "NaN"], [END_S, "2.5"], [END_S + 60, "9"]]
    with answering(result({"metric": {"cause": "lost"}, "values": values})) as prometheus:
        read = prometheus.history(SPANS["hour"], None, NOW_S)
    assert (read.times[0], read.times[-1], len(read.times)) == (END_S - 3600, END_S, 61)
    [stops] = [chart for chart in read.charts if chart.name == "guard_stops"]
    assert stops.lines == [Line("lost", [1.0, *[None] * 59, 2.5])]
    with answering(result()) as prometheus:
        assert all(not chart.lines for chart in prometheus.history(SPANS["hour"], None).charts)


def test_history_is_of_the_robot_whoever_has_its_name():
    [battery] = [chart for chart in CHARTS_OF_ROBOT if chart.name == "battery"]
    asked = query_of(battery, SPANS["hour"], 7)
    assert asked == 'max(robotether_robot_battery_percent{robot_id="7"})'


@pytest.mark.parametrize(
    ("answer", "status"),
    [
        (b"no JSON", "200 OK"),
        (b'{"data": {}}', "200 OK"),
        (result(), "500 X"),
        (b" " * 65, "200 OK"),
    ],
)
def test_what_is_no_answer_is_none(monkeypatch, answer, status):
    monkeypatch.setattr(history, "MAX_ANSWER_BYTES", 64)
    with answering(answer, status) as prometheus, pytest.raises(HistoryUnavailableError):
        prometheus.alerts()
