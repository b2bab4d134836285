"""What is measured of Robotether and of what else a user would take, and what the page says of it. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from numpy import quantile
from sections import NONE, Section

from paper.peers.measures import (
    EVERY_S,
    GIVE_UP_S,
    HELD_HZ,
    LOAD_BYTES,
    MESSAGE_BYTES,
    PATIENT_EVERY_S,
    RATE_HZ,
)
from paper.peers.transports import (
    ALIVE_S,
    ALIVE_TIMES,
    DEFAULT_QUALITY,
    FITTING_QUALITY,
    FRAMES,
    LINK,
    OURS,
    SSH,
    STRAIGHT,
    TITLES,
)
from paper.peers.vpn import WireGuard
from paper.step import Comparison, Data, Plot, Report, Results, Scale, Values, succeeded

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LATENCY, LOAD, CHANGES, PATIENCE = "latency", "load", "changes", "patience"
# Round trips in ms by the transport and what went on meanwhile.
Conditions = Mapping[str, Mapping[str, Sequence[float]]]
COLOURS = ("#0072b2", "#d55e00", "#e69f00")
TICKS_MS = (20, 50, 100, 200, 500, 1000, 2000)
BETWEEN_TRANSPORTS = 0.6
IDLE = "idle"
CAPTION = (
    "Round trips of a 200-byte message by transport, idle and behind video: the point is the median, the line ends at "
    "the 99th percentile."
)
# What stands in the page's first table; of the rest only what is worse is told.
COMPARED = (
    "round trip p50, idle",
    "round trip p99, behind video",
    "new address, p50",
    "processor time, both sides",
)


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How much is measured."""

    transports: Sequence[str] = tuple(TITLES)
    measures: Sequence[str] = (LATENCY, LOAD, CHANGES)
    # Of round trips, idle and behind each video; and until a video fills what it fills.
    seconds: float = 10.0
    settle_s: float = 5.0
    # How many of a transport's videos are looked at.
    videos: int = 2
    load_s: float = 6.0
    load_settle_s: float = 2.0
    connects: int = 5
    recovers: int = 5
    # Each of a bare `ssh -R`'s takes a minute, and one for which the operator waits takes two.
    ssh_recovers: int = 2

    def steps(self) -> list[tuple[str, str]]:
        """Transport and measure of each step; all transports of one measure stand together, as they are compared."""
        every = [(key, measure) for measure in self.measures for key in self.transports]
        return every + ([(SSH, PATIENCE)] if CHANGES in self.measures else [])


def plan_of(scale: Scale) -> Plan:
    if not scale.quick:
        return Plan()
    transports = (STRAIGHT, SSH, OURS)
    return Plan(transports=transports, measures=(LATENCY,), seconds=3.0, settle_s=2.0, videos=1)


def name_of(key: str, measure: str) -> str:
    return f"{key}-{measure}"


@dataclass(frozen=True)
class Measured:
    """All that was measured, by transport; what failed or has not run is not in it."""

    plan: Plan
    results: Results

    def of(self, key: str, measure: str) -> Values | None:
        return succeeded(self.results).get(name_of(key, measure))

    def row(self, key: str, measure: str, cells: int) -> tuple[str, ...]:
        why = "failed" if name_of(key, measure) in self.results else "has not run"
        return TITLES[key], why, *([NONE] * (cells - 1))

    def videos(self, key: str) -> Mapping[str, Mapping[str, Any]]:
        return (self.of(key, LATENCY) or {"videos": {}})["videos"]

    def conditions(self, key: str) -> dict[str, Sequence[float]]:
        """Round trips in ms by what went on meanwhile."""
        videos = {name: one["round_trips_ms"] for name, one in self.videos(key).items()}
        values = self.of(key, LATENCY)
        return {} if values is None else {IDLE: values["idle_ms"], **videos}


def report(plan: Plan, results: Results) -> Report:
    measured = Measured(plan, results)
    sections = [_latency_section(measured)]
    if LOAD in plan.measures:
        sections += [_load_section(measured), _changes_section(measured)]
    conditions = {
        TITLES[key]: found for key in plan.transports if (found := measured.conditions(key))
    }
    plot = Plot(
        name="peers-round-trips", caption=CAPTION, draw=partial(draw, conditions=conditions)
    )
    rows = [row for key in plan.transports if key != OURS for row in _comparisons(measured, key)]
    return Report(
        sections=sections,
        comparisons=[row for row in rows if row.what in COMPARED],
        plots=[plot] if conditions else [],
        data=[_round_trips_file(conditions), _frames_file(measured), _changes_file(measured)],
        shortfalls=[*_losses(rows), *_never(measured)],
    )


def draw(drawing: Figure, conditions: Conditions) -> None:
    """A row for each transport and what went on meanwhile, on a logarithmic axis."""
    axes = drawing.add_subplot()
    positions: list[float] = []
    names = []
    position = 0.0
    for transport, measured in conditions.items():
        for colour, (meanwhile, trips) in zip(COLOURS, measured.items(), strict=False):
            p50, p99 = quantile(trips, (0.5, 0.99))
            axes.plot([p50, p99], [position, position], color=colour, linewidth=2)
            axes.plot([p50], [position], color=colour, marker="o")
            positions.append(position)
            names.append(f"{transport}, {meanwhile}")
            position += 1
        position += BETWEEN_TRANSPORTS
    axes.set_yticks(positions, names, fontsize=8)
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xticks(TICKS_MS, [str(tick) for tick in TICKS_MS])
    axes.set_xlabel("round trip, ms")
    drawing.set_size_inches(8.0, 1.2 + 0.3 * len(positions))


def _latency_section(measured: Measured) -> Section:
    plan = measured.plan
    text = (
        f"One simulated robot is behind an emulated link ({LINK.name}, {LINK.ping_ms:g} ms), the operator beside the "
        "server. The transports are measured one after the other. "
        f"A {MESSAGE_BYTES}-byte std_msgs/String is published {RATE_HZ} times a second without waiting, and returns to "
        f"the same connection, for {plan.seconds:g} s each: on an idle link, and from {plan.settle_s:g} s after "
        "somebody opened the camera. The peers' video is plain MJPEG, in web_video_server's default quality, which is "
        "more than this link carries, and in one that fits. Robotether's frames protocol chooses the quality. Only "
        "Robotether has TLS to the operator, tickets, permissions and a guard on the robot; its figures include them. "
        "The robot's TCP is cubic unless a transport sets another.\n\n"
        f"Each peer is set up as its manual says: WireGuard with a keep-alive of {WireGuard.KEEPALIVE_S} s, OpenVPN "
        "over UDP with keep-alives of 10 and 120 s, nebula with the server as lighthouse, ssh with keep-alives of "
        f"{ALIVE_S} s, {ALIVE_TIMES} times, at both ends, and autossh without a monitoring port."
    )
    return Section(
        "Round trips and frames by transport",
        text,
        "transport | meanwhile | round trips | p50 ms | p99 ms | max ms | frames/s | KB each | age p50 ms | p95 ms",
        [row for key in plan.transports for row in _latency_rows(measured, key)],
    )


def _latency_rows(measured: Measured, key: str) -> list[tuple[object, ...]]:
    values = measured.of(key, LATENCY)
    if values is None:
        return [measured.row(key, LATENCY, 9)]
    rows = [(TITLES[key], IDLE, *_trips(values["idle_ms"]), *[NONE] * 4)]
    for video, one in values["videos"].items():
        p50, p95 = quantile(one["picture_ages_ms"], (0.5, 0.95))
        size = f"{one['picture_bytes'] / 1000:.0f}"
        frames = (f"{one['pictures_per_s']:.1f}", size, f"{p50:.0f}", f"{p95:.0f}")
        rows.append((TITLES[key], video, *_trips(one["round_trips_ms"]), *frames))
    return rows


def _trips(trips: Sequence[float]) -> tuple[object, ...]:
    return len(trips), *(f"{ms:.1f}" for ms in quantile(trips, (0.5, 0.99, 1)))


def _load_section(measured: Measured) -> Section:
    text = (
        f"For {measured.plan.load_s:g} s, a program on the robot publishes messages of {LOAD_BYTES // 1024} KiB to the "
        "operator on request, enough at a time that the link is always busy. The JSON text that arrives counts. "
        "Processor time is that of the transport's own programs for each 10^6 bytes that arrived: autossh, ssh and "
        "sshd; wireguard-go, openvpn or nebula at each end; for Robotether the agent with its guard and ssh, and all "
        "of sshd, relay and nginx. What the kernel does outside a program is not counted: without a tunnel that is "
        "everything."
    )
    return Section(
        "Throughput and processor time",
        text,
        f"transport | Mbit/s | of the link's {LINK.up_mbit_s:g} | robot's side, s per MB | server's side, s per MB",
        [_load_row(measured, key) for key in measured.plan.transports],
    )


def _load_row(measured: Measured, key: str) -> tuple[str, ...]:
    values = measured.of(key, LOAD)
    if values is None:
        return measured.row(key, LOAD, 4)
    mbit_s = values["payload_bit_s"] / 1e6
    assert LINK.up_mbit_s is not None
    sides = (values[f"{side}_cpu_s_per_mb"] for side in ("robot", "server"))
    cost = (NONE, NONE) if key == STRAIGHT else (f"{one:.3f}" for one in sides)
    return TITLES[key], f"{mbit_s:.2f}", f"{mbit_s / LINK.up_mbit_s:.0%}", *cost


def _changes_section(measured: Measured) -> Section:
    text = (
        "Start is from the start of the robot's client program until an operator has the first message that was "
        f"requested, on a connection that is tried again every {EVERY_S:g} s. New address is from when the robot has "
        "another address until a message passes, on such a new connection or on an older one that sends "
        f"{HELD_HZ} messages a second and subscribes to the robot's odometry. Each try ends after {GIVE_UP_S:g} s. "
        f"Without a tunnel the operator learns the new address at once.{_patient(measured)}"
    )
    return Section(
        "Starts and new addresses",
        text,
        "transport | start, p50 s | max s | never | new address, p50 s | max s | never",
        [_changes_row(measured, key) for key in measured.plan.transports],
    )


def _patient(measured: Measured) -> str:
    values = measured.of(SSH, PATIENCE)
    if values is None:
        return ""
    [took_s] = values["patient_s"]
    after = (
        "it did not come back in three minutes" if took_s is None else f"that took {took_s:.0f} s"
    )
    return (
        " Attempts into the dead tunnel of a bare ssh -R may keep it alive, and with it the port. This was not "
        "examined. Once, outside the table, the operator hung up and tried only every "
        f"{PATIENT_EVERY_S:g} s: {after}."
    )


def _changes_row(measured: Measured, key: str) -> tuple[str, ...]:
    values = measured.of(key, CHANGES)
    if values is None:
        return measured.row(key, CHANGES, 6)
    return TITLES[key], *_times(values["connect_s"]), *_times(values["recover_s"])


def _times(took_s: Sequence[float | None]) -> tuple[str, str, str]:
    good = in_time(took_s)
    never = f"{len(took_s) - len(good)} of {len(took_s)}"
    if not good:
        return NONE, NONE, never
    return f"{quantile(good, 0.5):.2f}", f"{max(good):.2f}", never


def in_time(took_s: Sequence[float | None]) -> list[float]:
    return [value for value in took_s if value is not None]


def figures(measured: Measured, key: str) -> dict[str, tuple[float, str, str]]:
    """What a transport is compared by: value, unit and which is better, by what it is."""
    found: dict[str, tuple[float, str, str]] = {}
    if idle := measured.conditions(key).get(IDLE):
        p50, p99 = quantile(idle, (0.5, 0.99))
        found["round trip p50, idle"] = (p50, "ms", "lower")
        found["round trip p99, idle"] = (p99, "ms", "lower")
    for meanwhile, video in (
        ("behind video", DEFAULT_QUALITY),
        ("behind video that fits", FITTING_QUALITY),
    ):
        if one := measured.videos(key).get(FRAMES if key == OURS else video):
            p50, p99 = quantile(one["round_trips_ms"], (0.5, 0.99))
            age = quantile(one["picture_ages_ms"], 0.95)
            found[f"round trip p50, {meanwhile}"] = (p50, "ms", "lower")
            found[f"round trip p99, {meanwhile}"] = (p99, "ms", "lower")
            found[f"age of frames p95, {meanwhile}"] = (age, "ms", "lower")
            found[f"frames a second, {meanwhile}"] = (one["pictures_per_s"], "1/s", "higher")
    if (load := measured.of(key, LOAD)) is not None:
        found["throughput to the operator"] = (load["payload_bit_s"] / 1e6, "Mbit/s", "higher")
        if key != STRAIGHT:
            cost = load["robot_cpu_s_per_mb"] + load["server_cpu_s_per_mb"]
            found["processor time, both sides"] = (cost, "s per MB", "lower")
    changes = measured.of(key, CHANGES) or {"connect_s": (), "recover_s": ()}
    for what, member in (("start", "connect_s"), ("new address", "recover_s")):
        if good := in_time(changes[member]):
            found[f"{what}, p50"] = (quantile(good, 0.5), "s", "lower")
    return found


def _comparisons(measured: Measured, key: str) -> list[Comparison]:
    ours = figures(measured, OURS)
    return [
        Comparison(
            what=what,
            against=TITLES[key],
            reference=value,
            ours=ours[what][0],
            unit=unit,
            better=better,
        )
        for what, (value, unit, better) in figures(measured, key).items()
        if what in ours
    ]


def _losses(rows: Sequence[Comparison]) -> list[str]:
    """A line for each figure that others have better, but for those of the first table."""
    worse: dict[str, list[Comparison]] = {}
    for row in rows:
        if row.is_short and row.what not in COMPARED:
            worse.setdefault(row.what, []).append(row)
    return [
        f"{what}: {some[0].ours:.3g} {some[0].unit}; "
        + "; ".join(f"{row.against}: {row.reference:.3g}" for row in some)
        for what, some in worse.items()
    ]


def _never(measured: Measured) -> list[str]:
    values = measured.of(OURS, CHANGES)
    if values is None:
        return []
    lost = sum(values[member].count(None) for member in ("connect_s", "recover_s"))
    return [f"{lost} starts or new addresses after which no message passed"] if lost else []


def _round_trips_file(conditions: Conditions) -> Data:
    return Data(
        name="peers-round-trips",
        about=f"Round trips of a {MESSAGE_BYTES}-byte message by transport and what went on meanwhile, in order",
        header=("way", "meanwhile", "round_trip_ms"),
        rows=[
            (title, meanwhile, round(value, 2))
            for title, found in conditions.items()
            for meanwhile, values in found.items()
            for value in values
        ],
    )


def _frames_file(measured: Measured) -> Data:
    return Data(
        name="peers-pictures",
        about="Age of each frame when it was whole at the operator, by transport and video, in order",
        header=("way", "video", "age_ms"),
        rows=[
            (TITLES[key], video, round(age, 2))
            for key in measured.plan.transports
            for video, one in measured.videos(key).items()
            for age in one["picture_ages_ms"]
        ],
    )


def _changes_file(measured: Measured) -> Data:
    return Data(
        name="peers-changes",
        about="Seconds until a message passed: connect_s after a start, recover_s after a new address, patient_s "
        "with an operator who waits",
        header=("way", "what", "seconds"),
        rows=[
            (TITLES[key], member, "never" if one is None else round(one, 3))
            for key, measure in measured.plan.steps()
            if measure in (CHANGES, PATIENCE)
            for member, took_s in (measured.of(key, measure) or {}).items()
            for one in took_s
        ],
    )
