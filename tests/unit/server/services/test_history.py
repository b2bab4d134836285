"""What is asked of Prometheus, and what becomes of its answers; one that answers is a web server of the tests."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

import pytest
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
def answering(answer: bytes, status: int = 200) -> Iterator[tuple[Prometheus, list[str]]]:
    """A server that answers so, and the targets that it was asked for."""
    targets: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            targets.append(self.path)
            self.send_response(status)
            self.send_header("Content-Length", str(len(answer)))
            self.end_headers()
            self.wfile.write(answer)

        def log_message(self, *_: object) -> None:
            """Write no log."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        Thread(target=server.serve_forever).start()
        try:
            yield Prometheus(("127.0.0.1", server.server_port)), targets
        finally:
            server.shutdown()


def result(*series: object) -> bytes:
    return json.dumps({"status": "success", "data": {"result": series}}).encode()


def test_what_prometheus_does_not_know_is_none_and_in_its_place():
    values = [[END_S - 3600, "1"], [END_S - 120, "NaN"], [END_S, "2.5"], [END_S + 60, "9"]]
    with answering(result({"metric": {"cause": "lost"}, "values": values})) as (prometheus, _):
        read = prometheus.history(SPANS["hour"], None, NOW_S)
    assert (read.times[0], read.times[-1], len(read.times)) == (END_S - 3600, END_S, 61)
    [stops] = [chart for chart in read.charts if chart.name == "guard_stops"]
    assert stops.lines == [Line("lost", [1.0, *[None] * 59, 2.5])]
    with answering(result()) as (prometheus, _):
        assert all(not chart.lines for chart in prometheus.history(SPANS["hour"], None).charts)


def test_a_robots_name_stays_a_value():
    name = 'a"} or vector(1) #\\\n$step'
    [battery] = [chart for chart in CHARTS_OF_ROBOT if chart.name == "battery"]
    assert query_of(battery, SPANS["hour"], name) == (
        'max(robotether_robot_battery_percent{robot="a\\"} or vector(1) #\\\\\\n$step"})'
    )


@pytest.mark.parametrize(
    ("answer", "status"),
    [(b"no JSON", 200), (b'{"data": {}}', 200), (result(), 500), (b" " * 65, 200)],
)
def test_what_is_no_answer_is_none(monkeypatch, answer, status):
    monkeypatch.setattr(history, "MAX_ANSWER_BYTES", 64)
    with answering(answer, status) as (prometheus, _), pytest.raises(HistoryUnavailableError):
        prometheus.alerts()
