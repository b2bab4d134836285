"""What the page says of Robotether beside what else a user would take. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sections import Section, quantile

from paper.peer_changes import EVERY_S, GIVE_UP_S, HELD_HZ, PATIENT_EVERY_S
from paper.peer_echo import MESSAGE_BYTES, RATE_HZ
from paper.peer_load import LOAD_BYTES
from paper.peer_plan import (
    CHANGES,
    DEFAULT_QUALITY,
    FITTING_QUALITY,
    FRAMES,
    LATENCY,
    LINK,
    LOAD,
    OURS,
    PATIENCE,
    SSH,
    STRAIGHT,
    TITLES,
    Plan,
    name_of,
)
from paper.peer_plots import plots
from paper.peer_ssh import ALIVE_S, ALIVE_TIMES
from paper.peer_vpn import WireGuard
from paper.step import Comparison, Data, Report, Results, Values, failures, succeeded

NONE = "-"
IDLE = "idle"


@dataclass(frozen=True)
class Measured:
    """All that was measured, by way; what failed or has not run is not in it."""

    plan: Plan
    results: Results

    def of(self, key: str, measure: str) -> Values | None:
        """What a way's step gave."""
        return succeeded(self.results).get(name_of(key, measure))

    def why_not(self, key: str, measure: str) -> str:
        """For a table, where there is nothing."""
        return "failed" if name_of(key, measure) in self.results else "has not run"

    def round_trips_ms(self, key: str, condition: str) -> Sequence[float] | None:
        """Idle, or behind a video."""
        values = self.of(key, LATENCY)
        if values is None:
            return None
        if condition == IDLE:
            return values["idle_ms"]
        return values["videos"].get(condition, {}).get("round_trips_ms")

    def video(self, key: str, video: str) -> Mapping[str, Any] | None:
        """What looking at it gave."""
        values = self.of(key, LATENCY)
        return None if values is None else values["videos"].get(video)


def report(plan: Plan, results: Results) -> Report:
    """The page's part."""
    measured = Measured(plan, results)
    sections = [_latency_section(measured)]
    if LOAD in plan.measures:
        sections += [_load_section(measured), _changes_section(measured)]
    return Report(
        sections=sections,
        comparisons=[row for key in _peers(plan) for row in _comparisons(measured, key)],
        plots=plots(_conditions(measured)),
        data=[_round_trips_file(measured), _frames_file(measured), _changes_file(measured)],
        shortfalls=[*failures(results), *_losses(measured), *_never(measured)],
    )


def _peers(plan: Plan) -> list[str]:
    return [key for key in plan.transports if key != OURS]


def _conditions(measured: Measured) -> dict[str, dict[str, Sequence[float]]]:
    """Round trips in ms by the way's title and what went on meanwhile."""
    found = {}
    for key in measured.plan.transports:
        values = measured.of(key, LATENCY)
        if values is not None:
            videos = {name: one["round_trips_ms"] for name, one in values["videos"].items()}
            found[TITLES[key]] = {IDLE: values["idle_ms"], **videos}
    return found


def _latency_section(measured: Measured) -> Section:
    text = (
        f"One simulated robot is behind an emulated link ({LINK.name}, {LINK.ping_ms:g} ms), the operator "
        f"beside the server. The transports are measured one after the other. A {MESSAGE_BYTES}-byte "
        f"std_msgs/String is published {RATE_HZ} times a second without waiting, and returns to the same "
        f"connection, for {measured.plan.seconds:g} s each: on an idle link, and from "
        f"{measured.plan.settle_s:g} s after somebody opened the camera. The peers' video is plain MJPEG, "
        "in web_video_server's default quality, which is more than this link carries, and in one that "
        "fits. Robotether uses its frames protocol, which chooses the quality. Only Robotether has TLS to "
        "the operator, tickets, permissions and a guard on the robot, and its figures include them. The "
        "robot's TCP is cubic, Debian's default, unless a transport sets another. Each peer is set up as "
        f"its own example or manual says: WireGuard with a keep-alive of {WireGuard.KEEPALIVE_S} s, "
        "OpenVPN over UDP with keep-alives of 10 and 120 s, nebula with the server as lighthouse, ssh "
        f"with keep-alives of {ALIVE_S} s, {ALIVE_TIMES} times, at both ends, and autossh without a "
        "monitoring port."
    )
    table = [
        "| transport | meanwhile | round trips | p50 ms | p99 ms | max ms | frames/s | KB each | age p50 ms | p95 ms |",
        "|---|---|---|---|---|---|---|---|---|---|",
        *(row for key in measured.plan.transports for row in _latency_rows(measured, key)),
    ]
    return Section("Round trips and frames by transport", text, table)


def _latency_rows(measured: Measured, key: str) -> list[str]:
    values = measured.of(key, LATENCY)
    if values is None:
        return [f"| {TITLES[key]} | {measured.why_not(key, LATENCY)} " + f"| {NONE} " * 8 + "|"]
    rows = [f"| {TITLES[key]} | {IDLE} | {_trips(values['idle_ms'])} " + f"| {NONE} " * 4 + "|"]
    for video, one in values["videos"].items():
        ages = one["picture_ages_ms"]
        rows.append(
            f"| {TITLES[key]} | {video} | {_trips(one['round_trips_ms'])} | {one['pictures_per_s']:.1f} "
            f"| {one['picture_bytes'] / 1000:.0f} | {quantile(ages, 0.5):.0f} | {quantile(ages, 0.95):.0f} |"
        )
    return rows


def _trips(trips: Sequence[float]) -> str:
    p50, p99 = quantile(trips, 0.5), quantile(trips, 0.99)
    return f"{len(trips)} | {p50:.1f} | {p99:.1f} | {max(trips):.1f}"


def _load_section(measured: Measured) -> Section:
    text = (
        f"For {measured.plan.load_s:g} s, a program on the robot publishes messages of "
        f"{LOAD_BYTES // 1024} KiB to the operator on request, enough at a time that the link is always "
        "busy. The JSON text that arrives counts. Processor time is user and system time of the "
        "transport's own programs for each 10^6 bytes that arrived: autossh, ssh and sshd; wireguard-go, "
        "openvpn or nebula at each end; for Robotether the agent with its guard and ssh, and all of sshd, "
        "relay and nginx. What the kernel does outside a program is not counted: without a tunnel that is "
        "everything."
    )
    table = [
        f"| transport | Mbit/s | of the link's {LINK.up_mbit_s:g} | robot's side, s per MB | server's side, s per MB |",
        "|---|---|---|---|---|",
        *(_load_row(measured, key) for key in measured.plan.transports),
    ]
    return Section("Throughput and processor time", text, table)


def _load_row(measured: Measured, key: str) -> str:
    values = measured.of(key, LOAD)
    if values is None:
        return f"| {TITLES[key]} | {measured.why_not(key, LOAD)} " + f"| {NONE} " * 3 + "|"
    mbit_s = values["payload_bit_s"] / 1e6
    assert LINK.up_mbit_s is not None
    cost = f"{values['robot_cpu_s_per_mb']:.3f} | {values['server_cpu_s_per_mb']:.3f}"
    cost = f"{NONE} | {NONE}" if key == STRAIGHT else cost
    return f"| {TITLES[key]} | {mbit_s:.2f} | {mbit_s / LINK.up_mbit_s:.0%} | {cost} |"


def _changes_section(measured: Measured) -> Section:
    text = (
        "Start is from the start of the robot's client program until an operator has the first message "
        f"that was requested, on a connection that is tried again every {EVERY_S:g} s. New address is from "
        "when the robot has another address until a message passes, on such a new connection or on an "
        f"older one that sends {HELD_HZ} messages a second and subscribes to the robot's odometry. Each "
        f"try ends after {GIVE_UP_S:g} s. Without a tunnel the operator learns the new address at "
        f"once.{_patient(measured)}"
    )
    table = [
        "| transport | start, p50 s | max s | never | new address, p50 s | max s | never |",
        "|---|---|---|---|---|---|---|",
        *(_changes_row(measured, key) for key in measured.plan.transports),
    ]
    return Section("Starts and new addresses", text, table)


def _patient(measured: Measured) -> str:
    values = measured.of(SSH, PATIENCE)
    if values is None:
        return ""
    [took_s] = values["patient_s"]
    after = (
        "it did not come back in three minutes" if took_s is None else f"that took {took_s:.0f} s"
    )
    return (
        " A bare ssh -R seems to need an operator who leaves it alone: attempts into the dead tunnel may keep it "
        "alive, and with it the port. This was not examined. Once, outside the table, the operator hung up and tried "
        f"only every {PATIENT_EVERY_S:g} s: {after}."
    )


def _changes_row(measured: Measured, key: str) -> str:
    values = measured.of(key, CHANGES)
    if values is None:
        return f"| {TITLES[key]} | {measured.why_not(key, CHANGES)} " + f"| {NONE} " * 5 + "|"
    return f"| {TITLES[key]} | {_times(values['connect_s'])} | {_times(values['recover_s'])} |"


def _times(took_s: Sequence[float | None]) -> str:
    good = in_time(took_s)
    never = f"{len(took_s) - len(good)} of {len(took_s)}"
    if not good:
        return f"{NONE} | {NONE} | {never}"
    return f"{quantile(good, 0.5):.2f} | {max(good):.2f} | {never}"


def in_time(took_s: Sequence[float | None]) -> list[float]:
    """Those that came to an end."""
    return [value for value in took_s if value is not None]


def figures(measured: Measured, key: str) -> dict[str, tuple[float, str, str]]:
    """What a way is compared by: value, unit and which is better, by what it is."""
    found: dict[str, tuple[float, str, str]] = {}
    if (idle := measured.round_trips_ms(key, IDLE)) is not None:
        found["round trip p50, idle"] = (quantile(idle, 0.5), "ms", "lower")
        found["round trip p99, idle"] = (quantile(idle, 0.99), "ms", "lower")
    videos = [("behind video", FRAMES if key == OURS else DEFAULT_QUALITY)]
    videos.append(("behind video that fits", FRAMES if key == OURS else FITTING_QUALITY))
    for meanwhile, video in videos:
        if (one := measured.video(key, video)) is not None:
            trips, ages = one["round_trips_ms"], one["picture_ages_ms"]
            found[f"round trip p50, {meanwhile}"] = (quantile(trips, 0.5), "ms", "lower")
            found[f"round trip p99, {meanwhile}"] = (quantile(trips, 0.99), "ms", "lower")
            found[f"age of frames p95, {meanwhile}"] = (quantile(ages, 0.95), "ms", "lower")
            found[f"frames a second, {meanwhile}"] = (one["pictures_per_s"], "1/s", "higher")
    if (load := measured.of(key, LOAD)) is not None:
        found["throughput to the operator"] = (load["payload_bit_s"] / 1e6, "Mbit/s", "higher")
        if key != STRAIGHT:
            cost = load["robot_cpu_s_per_mb"] + load["server_cpu_s_per_mb"]
            found["processor time, both sides"] = (cost, "s per MB", "lower")
    for what, member in (("start", "connect_s"), ("new address", "recover_s")):
        changes = measured.of(key, CHANGES)
        if changes is not None and (good := in_time(changes[member])):
            found[f"{what}, p50"] = (quantile(good, 0.5), "s", "lower")
    return found


# What stands in the page's first table; of the rest only what is worse is told.
COMPARED = (
    "round trip p50, idle",
    "round trip p99, behind video",
    "new address, p50",
    "processor time, both sides",
)


def _comparisons(measured: Measured, key: str) -> list[Comparison]:
    return [one for one in _all(measured, key) if one.what in COMPARED]


def _all(measured: Measured, key: str) -> list[Comparison]:
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


def _losses(measured: Measured) -> list[str]:
    rows = [row for key in _peers(measured.plan) for row in _all(measured, key)]
    return [
        f"{row.what}: {row.ours:.3g} {row.unit}, {row.against} {row.reference:.3g} {row.unit}"
        for row in rows
        if row.is_short and row.what not in COMPARED
    ]


def _never(measured: Measured) -> list[str]:
    values = measured.of(OURS, CHANGES)
    if values is None:
        return []
    lost = sum(values[member].count(None) for member in ("connect_s", "recover_s"))
    return [f"{lost} starts or new addresses after which no message passed"] if lost else []


def _round_trips_file(measured: Measured) -> Data:
    return Data(
        name="peers-round-trips",
        about=f"Round trips of a {MESSAGE_BYTES}-byte message by transport and what went on meanwhile, in order",
        header=("way", "meanwhile", "round_trip_ms"),
        rows=[
            (title, meanwhile, round(value, 2))
            for title, conditions in _conditions(measured).items()
            for meanwhile, values in conditions.items()
            for value in values
        ],
    )


def _frames_file(measured: Measured) -> Data:
    rows = []
    for key in measured.plan.transports:
        values = measured.of(key, LATENCY)
        for video, one in ({} if values is None else values["videos"]).items():
            rows += [(TITLES[key], video, round(age, 2)) for age in one["picture_ages_ms"]]
    return Data(
        name="peers-pictures",
        about="Age of each frame when it was whole at the operator, by transport and video, in order",
        header=("way", "video", "age_ms"),
        rows=rows,
    )


def _changes_file(measured: Measured) -> Data:
    rows = []
    for key, measure in measured.plan.steps():
        if measure not in (CHANGES, PATIENCE):
            continue
        for member, took_s in (measured.of(key, measure) or {}).items():
            rows += [
                (TITLES[key], member, "never" if one is None else round(one, 3)) for one in took_s
            ]
    return Data(
        name="peers-changes",
        about="Seconds until a message passed: connect_s after a start, recover_s after a new address, patient_s "
        "with an operator who waits",
        header=("way", "what", "seconds"),
        rows=rows,
    )
