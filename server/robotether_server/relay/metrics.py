"""The relay's numbers for Prometheus, in a registry of its own.

`app` serves them on the inside port. Counts that a message changes are plain integers, read here
when somebody asks.
"""

from __future__ import annotations

from collections import Counter as Counts
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    PlatformCollector,
    ProcessCollector,
    generate_latest,
)
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from robotether_server.backups import age_s, last_backup
from robotether_server.db.fleet import RelayRequest
from robotether_server.relay.channels.rosbridge.bridge import Traffic
from robotether_server.relay.channels.video.feeds import FeedTraffic


class Metrics:
    """Counters that the parts raise, and gauges that read the parts."""

    def __init__(self, traffic: Traffic) -> None:
        self._registry = CollectorRegistry()
        ProcessCollector(registry=self._registry)
        PlatformCollector(registry=self._registry)
        self._registry.register(_Collector(partial(_read_bridges, traffic)))
        self.refusals = self._counter("refusals", "Requests refused, by problem code", "code")
        self.close_reasons = self._counter(
            "connections_closed", "Operators' connections closed, by reason", "name"
        )
        self.session_close_codes = self._counter(
            "sessions_closed", "Robots' sessions closed, by reason", "code"
        )
        self.session_refusals = self._counter(
            "session_refusals", "Robots' connections refused, by reason", "code"
        )
        self.dropped_old = self._counter(
            "commands_dropped", "Drive commands dropped because they were too old"
        )
        self.guard_refusals = self._counter(
            "guard_refusals", "Messages refused by robots' guards, by kind", "kind"
        )
        self.port_checks = self._counter(
            "port_checks",
            "Checks of robots' ports, by result",
            "service",
            "health",
        )

    def gauge(self, name: str, meaning: str, read: Callable[[], float]) -> None:
        """Add a gauge that is read when somebody asks."""
        gauge = Gauge(f"robotether_relay_{name}", meaning, registry=self._registry)
        gauge.set_function(read)

    def collect_feeds(self, traffic: FeedTraffic) -> None:
        """Add what feeds count."""
        self._registry.register(_Collector(partial(_read_feeds, traffic)))

    def collect_backups(self, folder: Path) -> None:
        """Add the ages of the last backup and of its last copy, as they are recorded in the folder."""
        self._registry.register(_Collector(partial(_read_backups, folder)))

    def collect_help_requests(self, read: Callable[[], Sequence[RelayRequest] | None]) -> None:
        """Add the open requests for help, which are those of all cells; None: they are unknown."""
        self._registry.register(_Collector(partial(_read_help_requests, read)))

    def render(self) -> bytes:
        """Write all numbers in Prometheus' text format."""
        return generate_latest(self._registry)

    def _counter(self, name: str, meaning: str, *labels: str) -> Counter:
        return Counter(f"robotether_relay_{name}", meaning, labels, registry=self._registry)


class _Collector(Collector):
    """Makes numbers of what a part keeps, when somebody asks."""

    def __init__(self, read: Callable[[], Iterable[Metric]]) -> None:
        self._read = read

    def collect(self) -> Iterable[Metric]:
        return self._read()


def _family(
    name: str, meaning: str, label: str, counts: Mapping[str, float]
) -> CounterMetricFamily:
    family = CounterMetricFamily(f"robotether_relay_{name}", meaning, labels=[label])
    for kind, count in counts.items():
        family.add_metric([kind], count)
    return family


def _read_bridges(traffic: Traffic) -> Iterator[CounterMetricFamily]:
    messages = {"robot": traffic.messages_to_robot, "client": traffic.messages_to_client}
    yield _family("messages", "Rosbridge messages passed on", "to", messages)
    sizes = {"robot": traffic.bytes_to_robot, "client": traffic.bytes_to_client}
    yield _family("message_bytes", "Bytes of rosbridge messages", "to", sizes)
    meaning = "Rosbridge messages refused, by kind"
    yield _family("messages_refused", meaning, "kind", traffic.refused)


def _read_feeds(traffic: FeedTraffic) -> Iterator[CounterMetricFamily]:
    name, labels = "robotether_relay_frame", ["to", "codec"]
    frames = CounterMetricFamily(f"{name}s", "Frames received and sent, by codec", labels=labels)
    sizes = CounterMetricFamily(f"{name}_bytes", "Bytes of video frames, by codec", labels=labels)
    for codec, counts in traffic.by_codec.items():
        frames.add_metric(["relay", codec], counts.frames_in)
        frames.add_metric(["client", codec], counts.frames_out)
        sizes.add_metric(["relay", codec], counts.bytes_in)
        sizes.add_metric(["client", codec], counts.bytes_out)
    yield from (frames, sizes)
    meaning = "Frames skipped because a newer one was there"
    yield CounterMetricFamily("robotether_relay_frames_skipped", meaning, traffic.skipped)


def _read_backups(folder: Path) -> Iterator[GaugeMetricFamily]:
    age = GaugeMetricFamily(
        "robotether_relay_backup_age_seconds", "Age of the last backup; +Inf: none was made here"
    )
    copied = GaugeMetricFamily(
        "robotether_relay_backup_copy_age_seconds", "Time since a backup was copied; +Inf: never"
    )
    # What is not known has no value.
    if last := last_backup(folder):
        age.add_metric([], age_s(last.made_at))
        copied.add_metric([], age_s(last.copied_at))
    yield age
    yield copied


def _read_help_requests(
    read: Callable[[], Sequence[RelayRequest] | None],
) -> Iterator[GaugeMetricFamily]:
    count = GaugeMetricFamily(
        "robotether_relay_help_requests", "Open requests for help, by state", labels=["state"]
    )
    oldest = GaugeMetricFamily(
        "robotether_relay_help_request_age_seconds", "Age of the oldest open request for help"
    )
    # What is not known has no value, nor has the age of none.
    if (requests := read()) is not None:
        counts = Counts(request.state for request in requests)
        for state in ("waiting", "offered", "accepted"):
            count.add_metric([state], counts[state])
        if requests:
            oldest.add_metric([], max(request.age_s for request in requests))
    yield count
    yield oldest
