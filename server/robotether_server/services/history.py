"""Reads what Prometheus has kept of this site's numbers, if it runs: fixed queries alone, for one robot or all.

Used by the API for the page Health. A robot is named by its id, as another one may get its name. What Prometheus does
not know is None, never 0.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException
from string import Template
from typing import Any, Literal
from urllib.parse import urlencode

from msgspec import Struct

from robotether_server.problems import HistoryUnavailableError, reason_in

# Time limit for each answer, and its maximum size.
TIMEOUT_S = 3.0
MAX_ANSWER_BYTES = 4 * 1024 * 1024

Range = Literal["hour", "day", "week"]
Unit = Literal["count", "per_hour", "per_s", "seconds", "bits_per_s", "percent"]


@dataclass(frozen=True)
class Span:
    """How long ago it begins, and the interval between two values; each is of the time since the one before."""

    length_s: int
    step_s: int


SPANS: Mapping[Range, Span] = {
    "hour": Span(3600, 60),
    "day": Span(86_400, 600),
    "week": Span(7 * 86_400, 3600),
}


@dataclass(frozen=True)
class Chart:
    """One chart. In `query` $of is the selection of a robot, $step the interval; `label` tells its lines apart."""

    name: str
    unit: Unit
    query: str
    label: str = ""


_SEEN = "sum by (le) (rate(robotether_relay_seen_age_seconds_bucket[$step]))"
_QUANTILES = " or ".join(
    f'label_replace(histogram_quantile({part}, {_SEEN}), "q", "{name}", "", "")'
    for name, part in {"p50": 0.5, "p99": 0.99}.items()
)
ROBOTS = Chart("robots_online", "count", "sum(max by (robot) (robotether_robot_up))")
COMMON = (
    Chart(
        "guard_stops",
        "count",
        "sum by (cause) (increase(robotether_robot_guard_stops_total{$of}[$step]))",
        "cause",
    ),
    Chart("frames", "per_s", "sum(rate(robotether_robot_frames_total{$of}[$step]))"),
    Chart("video", "bits_per_s", "8 * sum(rate(robotether_robot_frame_bytes_total{$of}[$step]))"),
)
CHARTS_OF_SITE = (
    ROBOTS,
    Chart("seen_age", "seconds", _QUANTILES, "q"),
    *COMMON,
    Chart("requests_waiting", "count", 'max(robotether_relay_help_requests{state="waiting"})'),
    Chart(
        "refused_logins",
        "count",
        'sum(increase(robotether_web_logins_total{result!="accepted"}[$step]))',
    ),
    Chart(
        "web_errors", "count", 'sum(increase(robotether_web_requests_total{status="5xx"}[$step]))'
    ),
)
CHARTS_OF_ROBOT = (
    Chart("online", "count", "max(robotether_robot_up{$of})"),
    Chart("round_trip", "seconds", "max(robotether_robot_round_trip_seconds{$of})"),
    *COMMON,
    Chart("battery", "percent", "max(robotether_robot_battery_percent{$of})"),
)


class Line(Struct, frozen=True):
    """One line of a chart; a value is null where it is not known."""

    name: str
    values: list[float | None]


class ChartData(Struct, frozen=True):
    """One chart, with a line of values at the times of the history."""

    name: str
    unit: Unit
    lines: list[Line]


class History(Struct, frozen=True):
    """Charts over one time; `times` are in seconds since 1970."""

    times: list[int]
    charts: list[ChartData]


class FiringAlert(Struct, frozen=True):
    """An alert that lasts."""

    name: str
    summary: str


class Prometheus:
    """The site's Prometheus, inside the stack. All raise HistoryUnavailableError where it does not answer."""

    def __init__(self, endpoint: tuple[str, int]) -> None:
        self._endpoint = endpoint

    def history(self, span: Span, robot_id: int | None, now_s: float | None = None) -> History:
        """Read the charts of a robot, or of all."""
        end_s = int((time.time() if now_s is None else now_s) // span.step_s * span.step_s)
        times = list(range(end_s - span.length_s, end_s + 1, span.step_s))
        charts = CHARTS_OF_SITE if robot_id is None else CHARTS_OF_ROBOT
        return History(times, [self._chart(chart, times, span, robot_id) for chart in charts])

    def alerts(self) -> list[FiringAlert]:
        """Read what alerts last."""
        return [
            FiringAlert(alert["labels"]["alertname"], alert["annotations"].get("summary", ""))
            for alert in self._ask("alerts", {}, "alerts")
            if alert["state"] == "firing"
        ]

    def _chart(
        self, chart: Chart, times: Sequence[int], span: Span, robot_id: int | None
    ) -> ChartData:
        query = {
            "query": query_of(chart, span, robot_id),
            "start": times[0],
            "end": times[-1],
            "step": span.step_s,
        }
        lines = [
            Line(series["metric"].get(chart.label, ""), _values(series["values"], times, span))
            for series in self._ask("query_range", query)
        ]
        return ChartData(chart.name, chart.unit, sorted(lines, key=lambda line: line.name))

    def _ask(self, path: str, query: Mapping[str, object], member: str = "result") -> Any:
        try:
            return json.loads(self._read(f"/api/v1/{path}?{urlencode(query)}"))["data"][member]
        except (OSError, HTTPException, ValueError, KeyError, TypeError) as error:
            raise HistoryUnavailableError(
                f"cannot read the history: Prometheus does not answer ({reason_in(error)}); it runs with the "
                "profile metrics"
            ) from error

    def _read(self, target: str) -> bytes:
        connection = HTTPConnection(*self._endpoint, timeout=TIMEOUT_S)
        try:
            connection.request("GET", target)
            answer = connection.getresponse()
            body = answer.read(MAX_ANSWER_BYTES + 1)
        finally:
            connection.close()
        if answer.status != HTTPStatus.OK or len(body) > MAX_ANSWER_BYTES:
            raise ValueError(f"status {answer.status}, {len(body)} bytes")
        return body


def query_of(chart: Chart, span: Span, robot_id: int | None) -> str:
    """Return the query of a chart for a robot, or for all."""
    selection = "" if robot_id is None else f'robot_id="{robot_id}"'
    return Template(chart.query).substitute(of=selection, step=f"{span.step_s}s")


def _values(
    samples: Sequence[tuple[float, str]], times: Sequence[int], span: Span
) -> list[float | None]:
    values: list[float | None] = [None] * len(times)
    for at_s, text in samples:
        index = round((at_s - times[0]) / span.step_s)
        if 0 <= index < len(values):
            values[index] = _number(text)
    return values


def _number(text: str) -> float | None:
    number = float(text)
    return number if math.isfinite(number) else None
