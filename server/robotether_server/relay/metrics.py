"""The relay's numbers for Prometheus, in a registry of its own.

`app` serves them on the inside port. Counts that a message changes are plain integers, read here
when somebody asks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    PlatformCollector,
    ProcessCollector,
    generate_latest,
)
from prometheus_client.core import CounterMetricFamily
from prometheus_client.registry import Collector

from robotether_server.relay.rosbridge.bridge import Traffic
from robotether_server.relay.video.feeds import FeedTraffic


class Metrics:
    """Counters that the parts raise, and gauges that read the parts."""

    def __init__(self, traffic: Traffic) -> None:
        self._registry = CollectorRegistry()
        ProcessCollector(registry=self._registry)
        PlatformCollector(registry=self._registry)
        self._registry.register(_TrafficCollector(traffic))
        self.refusals = self._counter("refusals", "Requests refused, by problem code", "code")
        self.close_reasons = self._counter(
            "connection_endings", "Operators' connections ended, by reason", "name"
        )
        self.session_close_codes = self._counter(
            "session_endings", "Robots' sessions ended, by reason", "code"
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
        self._registry.register(_FeedCollector(traffic))

    def render(self) -> bytes:
        """Write all numbers in Prometheus' text format."""
        return generate_latest(self._registry)

    def _counter(self, name: str, meaning: str, *labels: str) -> Counter:
        return Counter(f"robotether_relay_{name}", meaning, labels, registry=self._registry)


class _TrafficCollector(Collector):
    def __init__(self, traffic: Traffic) -> None:
        self._traffic = traffic

    def collect(self) -> Iterable[CounterMetricFamily]:
        traffic = self._traffic
        messages = CounterMetricFamily(
            "robotether_relay_messages", "Rosbridge messages passed on", labels=["to"]
        )
        messages.add_metric(["robot"], traffic.messages_to_robot)
        messages.add_metric(["client"], traffic.messages_to_client)
        sizes = CounterMetricFamily(
            "robotether_relay_message_bytes", "Bytes of rosbridge messages", labels=["to"]
        )
        sizes.add_metric(["robot"], traffic.bytes_to_robot)
        sizes.add_metric(["client"], traffic.bytes_to_client)
        refused = CounterMetricFamily(
            "robotether_relay_messages_refused",
            "Rosbridge messages refused, by kind",
            labels=["kind"],
        )
        for kind, count in traffic.refused.items():
            refused.add_metric([kind], count)
        return [messages, sizes, refused]


class _FeedCollector(Collector):
    def __init__(self, traffic: FeedTraffic) -> None:
        self._traffic = traffic

    def collect(self) -> Iterable[CounterMetricFamily]:
        traffic = self._traffic
        frames = CounterMetricFamily(
            "robotether_relay_pictures", "Frames received and sent", labels=["to"]
        )
        frames.add_metric(["relay"], traffic.frames_in)
        frames.add_metric(["client"], traffic.frames_out)
        sizes = CounterMetricFamily(
            "robotether_relay_picture_bytes", "Bytes of pictures", labels=["to"]
        )
        sizes.add_metric(["relay"], traffic.bytes_in)
        sizes.add_metric(["client"], traffic.bytes_out)
        skipped = CounterMetricFamily(
            "robotether_relay_pictures_skipped", "Frames skipped because a newer one was there"
        )
        skipped.add_metric([], traffic.skipped)
        return [frames, sizes, skipped]
