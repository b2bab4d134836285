"""The numbers of web for Prometheus, in a registry of its own: requests, log-ins, refused keys, the certificate.

`create_app` makes it and counts requests, the log-in page log-ins. `start_app` serves them on the inside port, and
/api/v1/metrics/web to admins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Literal

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Histogram,
    ProcessCollector,
    generate_latest,
)
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from robotether_server.db import Database, audit
from robotether_server.install_line import SiteCertificates
from robotether_server.problems import RobotetherError
from robotether_server.times import BOUNDS_S

LoginResult = Literal["accepted", "refused", "throttled"]
STATUS_CLASSES = ("2xx", "3xx", "4xx", "5xx")


class WebMetrics:
    """Counters that requests raise, and gauges that are read when somebody asks."""

    def __init__(self, database: Database, certificates: SiteCertificates) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        self._requests = self._counter("requests", "Requests, by the class of the answer", "status")
        self._logins = self._counter("logins", "Log-ins of people, by result", "result")
        self._durations = Histogram(
            "robotether_web_request_duration_seconds",
            "Time from a request to its answer",
            buckets=BOUNDS_S,
            registry=self.registry,
        )
        for status in STATUS_CLASSES:
            self._requests.labels(status)
        for result in ("accepted", "refused", "throttled"):
            self._logins.labels(result)
        self.registry.register(
            _Reading(
                "refused_keys",
                "SSH keys of strangers that sshd refused, in the audit log's lines of the last hour",
                lambda: database.run(audit.count_refused_keys, briefly=True),
            )
        )
        self.registry.register(
            _Reading(
                "certificate_expiry_timestamp_seconds",
                "When the certificate ends that nginx shows",
                lambda: _certificate_end(certificates),
            )
        )

    def count_request(self, status: int, took_s: float) -> None:
        """Count an answered request."""
        self._requests.labels(f"{status // 100}xx").inc()
        self._durations.observe(took_s)

    def count_login(self, result: LoginResult) -> None:
        """Count a log-in with a name and a password."""
        self._logins.labels(result).inc()

    def render(self) -> bytes:
        """Write all numbers in Prometheus' text format."""
        return generate_latest(self.registry)

    def _counter(self, name: str, meaning: str, label: str) -> Counter:
        return Counter(f"robotether_web_{name}", meaning, [label], registry=self.registry)


class _Reading(Collector):
    """A gauge without a value while it cannot be read."""

    def __init__(self, name: str, meaning: str, read: Callable[[], float | None]) -> None:
        self._family = (f"robotether_web_{name}", meaning)
        self._read = read

    def describe(self) -> Iterable[Metric]:
        return [GaugeMetricFamily(*self._family)]

    def collect(self) -> Iterable[Metric]:
        try:
            value = self._read()
        except RobotetherError:
            value = None
        return [GaugeMetricFamily(*self._family, value)]


def _certificate_end(certificates: SiteCertificates) -> float | None:
    ends_at = certificates.own().ends_at
    return None if ends_at is None else ends_at.timestamp()
