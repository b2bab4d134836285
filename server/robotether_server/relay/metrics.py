"""The relay's numbers for Prometheus, in a registry of its own.

`app` serves them on the inside port. Counts that a message changes are plain integers, read here
when somebody asks.
"""

from __future__ import annotations

import time
from collections import Counter as Counts
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from functools import partial
from itertools import accumulate, product
from pathlib import Path
from typing import get_args

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Info,
    PlatformCollector,
    ProcessCollector,
    generate_latest,
)
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector
from robotether_common.guard import REFUSED_KINDS
from robotether_common.session import ByeCode, ServiceState

from robotether_server import __version__, problems
from robotether_server.backups import RECORD, age_s, last_backup
from robotether_server.contract.codes import CLOSE_CODES
from robotether_server.db.fleet import RelayRequest, Snapshot
from robotether_server.disks import DATABASE_CURRENT_S, DATABASE_RECORD, DiskSpace, recorded_space
from robotether_server.problems import RobotetherError
from robotether_server.relay.cells.cells import Cells
from robotether_server.relay.channels.rosbridge.bridge import Traffic
from robotether_server.relay.channels.video.feeds import FeedTraffic
from robotether_server.relay.http.timing import TimeHistogram
from robotether_server.relay.records.database import RelayDatabase
from robotether_server.relay.robot_metrics import write_robots
from robotether_server.relay.robots.port_checks import PROBES
from robotether_server.relay.robots.registry import SessionRegistry
from robotether_server.relay.robots.session_server import SessionServer
from robotether_server.times import BOUNDS_S

# Maximum number of samples that are written at once, in some 3 ms.
SAMPLES_IN_PART = 500


class Metrics:
    """Counters that the parts raise, and gauges that read the parts."""

    def __init__(self, traffic: Traffic) -> None:
        self._registry = CollectorRegistry()
        self._write_robots: Callable[[], Iterator[bytes]] = lambda: iter(())
        ProcessCollector(registry=self._registry)
        PlatformCollector(registry=self._registry)
        self.collect(partial(_read_bridges, traffic))
        self.seen_ages, self.robot_round_trips = TimeHistogram(), TimeHistogram()
        round_trips = {"driver": traffic.round_trips, "robot": self.robot_round_trips}
        self.collect(partial(_read_times, self.seen_ages, round_trips))
        self.seen_unknown = self._counter(
            "seen_age_unknown",
            "Drive commands of which nobody knows how old was what the driver saw",
        )
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
        # From the start on, as increase() misses the first of what was not there before.
        for code in ("preface", *get_args(ByeCode)):
            self.session_refusals.labels(code)
            self.session_close_codes.labels(code)
        for kind in REFUSED_KINDS:
            self.guard_refusals.labels(kind)
        for name in CLOSE_CODES:
            self.close_reasons.labels(name)
        for service, health in product(PROBES, get_args(ServiceState)):
            self.port_checks.labels(service, health)
        for problem in vars(problems).values():
            if isinstance(problem, type) and issubclass(problem, RobotetherError):
                self.refusals.labels(problem.code)

    def collect_parts(self, sessions: SessionServer, database: RelayDatabase, cells: Cells) -> None:
        """Add log-ins, the database, the disks, the backups, and which version runs in which cell."""
        meaning = "Robots' SSH connections that were accepted, by kind"
        self.collect(lambda: [_family("logins", meaning, "kind", sessions.logins)])
        self.collect(partial(_read_database, database))
        self.collect(lambda: read_disks(cells.disk, DATABASE_RECORD, RECORD))
        self.collect(lambda: read_room(cells.recordings_free))
        self.collect(partial(read_backups, RECORD))
        build = Info("robotether_build", "What runs here", registry=self._registry)
        build.info({"version": __version__, "cell": cells.name})

    def collect(self, read: Callable[[], Iterable[Metric]]) -> None:
        """Add numbers that are read when somebody asks."""
        self._registry.register(_Collector(read))

    def collect_robots(self, snapshot: Callable[[], Snapshot], registry: SessionRegistry) -> None:
        """Add what each robot reports to this cell: a bounded number of series for each."""
        self._write_robots = lambda: write_robots(snapshot(), registry)

    def count_seen(self, ages_ms: Iterable[float | None]) -> None:
        """Count how old was what a driver saw, command by command; None: unknown."""
        for age_ms in ages_ms:
            if age_ms is None:
                self.seen_unknown.inc()
            else:
                self.seen_ages.add(age_ms / 1000)

    def parts(self) -> Iterator[bytes]:
        """Write all numbers in Prometheus' text format, a few at a time: a part holds nobody up."""
        for family in self._registry.collect():
            samples = family.samples
            for start in range(0, len(samples) or 1, SAMPLES_IN_PART):
                part = copy(family)
                part.samples = samples[start : start + SAMPLES_IN_PART]
                text = generate_latest(_OneFamily(part))
                # A family has its meaning and its type once.
                yield text.split(b"\n", 2)[2] if start else text
        yield from self._write_robots()

    def render(self) -> bytes:
        """Write all numbers at once."""
        return b"".join(self.parts())

    def gauge(self, name: str, meaning: str, read: Callable[[], float]) -> None:
        """Add a number that is read when somebody asks."""
        gauge = Gauge(f"robotether_relay_{name}", meaning, registry=self._registry)
        gauge.set_function(read)

    def _counter(self, name: str, meaning: str, *labels: str) -> Counter:
        return Counter(f"robotether_relay_{name}", meaning, labels, registry=self._registry)


class _Collector(Collector):
    """Makes numbers of what a part keeps, when somebody asks."""

    def __init__(self, read: Callable[[], Iterable[Metric]]) -> None:
        self._read = read

    def collect(self) -> Iterable[Metric]:
        return self._read()


class _OneFamily(CollectorRegistry):
    """A registry of one family that is already read."""

    def __init__(self, family: Metric) -> None:
        super().__init__()
        self._family = family

    def collect(self) -> Iterator[Metric]:
        yield self._family


def _family(
    name: str, meaning: str, label: str, counts: Mapping[str, float]
) -> CounterMetricFamily:
    family = CounterMetricFamily(f"robotether_relay_{name}", meaning, labels=[label])
    for kind, count in counts.items():
        family.add_metric([kind], count)
    return family


def _read_bridges(traffic: Traffic) -> Iterator[Metric]:
    messages = {"robot": traffic.messages_to_robot, "client": traffic.messages_to_client}
    yield _family("messages", "Rosbridge messages passed on", "to", messages)
    sizes = {"robot": traffic.bytes_to_robot, "client": traffic.bytes_to_client}
    yield _family("message_bytes", "Bytes of rosbridge messages", "to", sizes)
    meaning = "Rosbridge messages refused, by kind"
    yield _family("messages_refused", meaning, "kind", traffic.refused)
    meaning = "Age of drive commands when the relay sends them to the robot"
    yield _histogram("command_age_seconds", meaning, {"": traffic.command_ages})


def read_feeds(traffic: FeedTraffic) -> Iterator[Metric]:
    """Say what feeds count."""
    name, labels = "robotether_relay_frame", ["to", "codec"]
    frames = CounterMetricFamily(f"{name}s", "Frames received and sent, by codec", labels=labels)
    sizes = CounterMetricFamily(f"{name}_bytes", "Bytes of video frames, by codec", labels=labels)
    for codec, counts in traffic.by_codec.items():
        frames.add_metric(["relay", codec], counts.frames_in)
        frames.add_metric(["client", codec], counts.frames_out)
        sizes.add_metric(["relay", codec], counts.bytes_in)
        sizes.add_metric(["client", codec], counts.bytes_out)
    yield from (frames, sizes)
    meaning = "Age of frames when they come to the relay"
    yield _histogram("frame_age_seconds", meaning, {"": traffic.frame_ages})
    meaning = "Frames skipped because a newer one was there"
    yield CounterMetricFamily("robotether_relay_frames_skipped", meaning, traffic.skipped)


def read_backups(folder: Path) -> Iterator[GaugeMetricFamily]:
    """Say how old the last backup and its last copy are, as they are recorded in the folder."""
    age = GaugeMetricFamily(
        "robotether_relay_backup_age_seconds", "Age of the last backup; +Inf: none was made here"
    )
    copied = GaugeMetricFamily(
        "robotether_relay_backup_copy_age_seconds", "Time since a backup was copied; +Inf: never"
    )
    # What is not known has no value, nor has what is of the future by this machine's clock.
    if last := last_backup(folder):
        for family, timestamp in ((age, last.made_at), (copied, last.copied_at)):
            if (value := age_s(timestamp)) >= 0:
                family.add_metric([], value)
    yield from (age, copied)


def _read_database(database: RelayDatabase) -> Iterator[GaugeMetricFamily]:
    age = GaugeMetricFamily(
        "robotether_relay_database_write_age_seconds", "Time since the database last wrote for us"
    )
    if database.written_at_s is not None:
        age.add_metric([], time.monotonic() - database.written_at_s)
    yield age
    name, meaning = "robotether_relay_database_connections", "Connections to the database, of whom"
    used = GaugeMetricFamily(name, meaning, labels=["account"])
    limit = GaugeMetricFamily(f"{name}_limit", "Maximum number of these", labels=["account"])
    for account, count in (database.connections or {}).items():
        used.add_metric([account], count.used)
        limit.add_metric([account], count.limit)
    yield from (used, limit)


def read_disks(
    relay: DiskSpace | None, database_record: Path, backup_record: Path
) -> Iterator[Metric]:
    """Say how full the disks of relay, database and backups are; one that is unknown has no value."""
    spaces = {
        "relay": relay,
        "database": recorded_space(database_record, DATABASE_CURRENT_S),
        "backups": recorded_space(backup_record / "disk"),
    }
    meaning = "Free part of the disk of a volume, from 0 to 1; of backups when the last was made"
    labels = ["volume", "device"]
    family = GaugeMetricFamily("robotether_relay_disk_free_ratio", meaning, labels=labels)
    for volume, space in spaces.items():
        if space is not None:
            family.add_metric([volume, space.device], space.free_part)
    yield family


def read_room(free: float | None) -> Iterator[Metric]:
    """Say which part of the room for recordings is free; None: it is unknown."""
    meaning = (
        "Free part of the room for recordings, from 0 to 1: of their disk, or of RECORDINGS_MAX_GB"
    )
    room = GaugeMetricFamily("robotether_relay_recordings_free_ratio", meaning)
    if free is not None:
        room.add_metric([], free)
    yield room


def read_help_requests(
    read: Callable[[], Sequence[RelayRequest] | None],
) -> Iterator[GaugeMetricFamily]:
    """Say what robots' open requests for help are, which are those of all cells; None: they are unknown."""
    count = GaugeMetricFamily(
        "robotether_relay_help_requests", "Open requests for help, by state", labels=["state"]
    )
    oldest = GaugeMetricFamily(
        "robotether_relay_help_request_age_seconds", "Age of the oldest open request for help"
    )
    longest = GaugeMetricFamily(
        "robotether_relay_help_request_waiting_age_seconds",
        "Longest time that a request waits now, offered or not, since it was made or let go again",
    )
    # What is not known has no value, nor has the age of none.
    if (requests := read()) is not None:
        counts = Counts(request.state for request in requests)
        for state in ("waiting", "offered", "accepted"):
            count.add_metric([state], counts[state])
        if requests:
            oldest.add_metric([], max(request.age_s for request in requests))
        if waits := [request.waited_s for request in requests if request.state != "accepted"]:
            longest.add_metric([], max(waits))
    yield from (count, oldest, longest)


def _read_times(
    seen_ages: TimeHistogram, round_trips: Mapping[str, TimeHistogram]
) -> Iterator[HistogramMetricFamily]:
    meaning = "Age, at most, of what drivers saw when their commands came to the robot"
    yield _histogram("seen_age_seconds", meaning, {"": seen_ages})
    meaning = "Round trips from the relay to drivers and to robots"
    yield _histogram("round_trip_seconds", meaning, round_trips, "to")


def _histogram(
    name: str, meaning: str, histograms: Mapping[str, TimeHistogram], *labels: str
) -> HistogramMetricFamily:
    family = HistogramMetricFamily(f"robotether_relay_{name}", meaning, labels=labels)
    for value, histogram in histograms.items():
        counts = list(accumulate(histogram.counts))
        bounds = [*map(str, BOUNDS_S), "+Inf"]
        family.add_metric(
            [value] if labels else [],
            buckets=list(zip(bounds, counts, strict=True)),
            sum_value=histogram.sum_s,
        )
    return family
