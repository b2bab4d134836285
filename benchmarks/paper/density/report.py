"""What the page says of fleets that idle, are driven, return and last, with the aims beside. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from numpy import quantile
from sections import NONE, Section, fixed, plain

from paper.fleet.report import AGENTS, FAILED_AFTER_S, MIB, OTHERS, SERVER, Group, present
from paper.numbered.messages import Histogram
from paper.step import Comparison, Outcome, Report, Results, Values, against_aim, succeeded

RATE_HZ = 50
# Of issue 17, on two cores for everything; those of a start, of idle robots and memory are a robot's.
AIM_RETURN_P50_S = 30.0
AIM_IDLE_MS, AIM_MEMORY_MIB, AIM_START_MS = 0.5, 2.5, 60.0
AIM_DRIVE_P99_MS = 50.0
AIM_SOAK_PERCENT = 3.0
MS_PER_S = 1000.0
KINDS = {"agent": "agents", "virtual": "virtual robots"}


def report(results: Results) -> Report:
    """The part's report, of the steps that have run."""
    values = succeeded(results)
    fleets = [one for name, one in values.items() if name.startswith("fleet-")]
    compared = {name: one for name, one in values.items() if name.startswith(("agents", "virtual"))}
    soaks = [one for name, one in values.items() if name.startswith("soak-")]
    return Report(
        sections=[
            _costs(compared, fleets),
            _driven(fleets),
            _returns(fleets),
            *map(_soak, soaks),
        ],
        comparisons=[*_comparisons(fleets), *_of_soaks(soaks)],
        shortfalls=list(_shortfalls(fleets, soaks)),
    )


def group(count: int, run: Values) -> Group:
    """One run as the startup part has it."""
    return Group("start", count, "", 1, [Outcome(values=run)])


def start_ms(started: Group) -> float | None:
    """The processor time of all server processes for one robot's start, its first message included."""
    return _times(started.per_robot("cpu_s", SERVER), MS_PER_S)


def idle_ms(started: Group, names: Sequence[str] = SERVER) -> float | None:
    """Milliseconds of processor a second that one idle robot costs."""
    online = len(present(started.runs[0]["online_s"]))
    return _times(started.idle_load(names), MS_PER_S / online) if online else None


def memory_mib(started: Group) -> float | None:
    return _times(started.per_robot("memory_bytes", SERVER), 1 / MIB)


def _costs(compared: Mapping[str, Values], fleets: Sequence[Values]) -> Section:
    text = (
        "Virtual robots say what an agent says, in the same order, and answer as its guard and rosbridge do; "
        "benchmarks/tests/test_virtual.py compares both. Hundreds share a process, so that a fleet leaves the "
        f"machine to its server. Some of each fleet ({AGENTS} outside a quick run) are the real agent. Differences "
        "that the server can see: a virtual robot takes mlkem768x25519 for its key exchange, as OpenSSH 10 does, or "
        "curve25519 with an older sshd; this machine's OpenSSH client, which the agents use, may prefer sntrup761. It "
        "takes AES-GCM in place of ChaCha20, and has neither battery nor shell. The first two rows show what that "
        "makes for the server.\n\nA start is all processor time of the server's containers from the order to start "
        "until the last robot had its message, for each robot; idle is that of an online fleet that nobody uses, with "
        "the containers' own work, which shows in small fleets; memory is what the containers gained."
        f"{_carries(fleets)}"
    )
    rows = [
        _cost_row(name.replace("-", ": ", 1), one["count"], one) for name, one in compared.items()
    ]
    rows += [
        _cost_row(f"fleet: {one['count']}, {one['agents']} of them agents", one["count"], one)
        for one in fleets
    ]
    columns = (
        "robots | with a message in time | p50, s | max, s | start, server, ms (sshd / relay / others) | robots' side, "
        "ms | idle, server, ms a s (sshd / relay / others) | robots' side, ms a s | memory, MiB"
    )
    return Section("What a robot costs the server", text, columns, rows)


def _carries(fleets: Sequence[Values]) -> str:
    """How many idle robots a core and a GiB carry, by the largest fleet of which all came."""
    whole = [group(one["count"], one["start"]) for one in fleets]
    whole = [one for one in whole if not one.never]
    if not whole:
        return ""
    largest = whole[-1]
    idle, memory = idle_ms(largest), memory_mib(largest)
    if not idle or not memory or memory < 0:
        return ""
    return (
        f" By the fleet of {largest.count}, one core of the server carries {MS_PER_S / idle:.0f} robots that "
        f"idle, and one GiB {1024 / memory:.0f}."
    )


def _cost_row(name: str, count: int, values: Values) -> Sequence[object]:
    started = group(count, values["start"])
    parts = (("sshd",), ("relay",), OTHERS)
    starts = " / ".join(_number(_times(started.per_robot("cpu_s", one), MS_PER_S)) for one in parts)
    idles = " / ".join(_number(idle_ms(started, one)) for one in parts)
    return (
        plain(name),
        f"{started.in_time} of {started.wanted}",
        *_two(started.message_s),
        f"{_number(start_ms(started))} ({starts})",
        _number(_times(started.per_robot("cpu_s", ("robots",)), MS_PER_S)),
        f"{_number(idle_ms(started))} ({idles})",
        _number(idle_ms(started, ("robots",))),
        _number(memory_mib(started)),
    )


def _driven(fleets: Sequence[Values]) -> Section:
    text = (
        f"One process drives some of an online fleet, each robot at {RATE_HZ} Hz by a user's drive connection, and "
        "listens to the same topic: a round trip is nginx, relay, sshd, the robot's guard and rosbridge, and back. A "
        "command that is not heard is lost; the relay and the guard drop commands that are too old, and a newer one "
        "replaces one that waits. Sent late is how long after its time a command left that process, which shares the "
        "machine; no round trip has it in it. Busy is the whole machine while they drive, others what has no part in "
        "it. All robots have the normal priority then; up to their first message they have the lowest."
    )
    rows = [row for one in fleets for row in _driven_rows(one)]
    columns = (
        "robots | driven | commands | lost | not sent | refusals told | connections that ended | p50, ms | p99, ms "
        "| max, ms | sent late, p99, ms | server, % of a core | cores busy | others"
    )
    return Section("Driving in a fleet", text, columns, rows)


def _driven_rows(fleet: Values) -> Iterable[Sequence[object]]:
    drive = fleet["drive"]
    if "failure" in drive:
        yield (fleet["count"], plain(drive["failure"][:200]), *[NONE] * 12)
        return
    used, took_s = drive["fleet_cpu_s"], drive["took_s"]
    server = 100 * sum(used[name] for name in SERVER) / took_s
    busy = sum(used.values()) / took_s
    # The drivers are a process of their own.
    others = (used["rest"] - drive["cpu_s"]) / took_s
    for kind, words in KINDS.items():
        some = [one for one in drive["drives"] if one["kind"] == kind]
        if some:
            yield (
                fleet["count"],
                f"{len(some)} {words}",
                *_counts(some),
                *_quantiles_ms(_merged(some, "round_trips")),
                fixed(_merged(some, "late").quantile_ms(0.99), 1),
                f"{server:.0f}",
                f"{busy:.2f}",
                f"{others:.2f}",
            )


def _counts(drives: Sequence[Mapping[str, Any]]) -> list[int]:
    sums = [sum(one[name] for one in drives) for name in ("sent", "lost", "unsent")]
    return [*sums, *(_told(drives, name).total() for name in ("refused", "endings"))]


def _merged(drives: Iterable[Mapping[str, Any]], name: str) -> Histogram:
    """One histogram of all; results that were kept before it was measured have none."""
    return Histogram.merged(Histogram.of(one.get(name, {})) for one in drives)


def _returns(fleets: Sequence[Values]) -> Section:
    text = (
        "All containers of the server are killed and started again. The time is from just before the kill until a "
        "robot has received a message that an operator sent afterwards, so it is drivable. A robot without one after "
        f"{FAILED_AFTER_S:g} s has failed."
    )
    rows = []
    for one in fleets:
        back = group(one["count"], one["return"])
        share = f"{back.in_time} of {back.wanted}"
        answers = fixed(one["return"]["server_s"], 2)
        rows.append((one["count"], share, back.late, back.never, answers, *_two(back.message_s)))
    columns = "robots | back in time | later | never | server answers, s | p50, s | max, s"
    return Section("All containers restart", text, columns, rows)


def _soak(soak: Values) -> Section:
    text = (
        f"{soak['count']} robots for {soak['seconds'] / 60:.3g} minutes. {soak['driven']} of them are driven at "
        f"{RATE_HZ} Hz; after each part sshd's connections of all robots are killed, and all return. Memory is all "
        "containers' at the end of the part, before that."
    )
    rows = []
    for number, one in enumerate(soak["rounds"], 1):
        drive = one["drive"]
        drives = drive.get("drives", [])
        back = present(one["message_s"])
        sums = _counts(drives) if drives else [plain(drive["failure"][:100]), *[NONE] * 4]
        p99 = fixed(_merged(drives, "round_trips").quantile_ms(0.99), 1)
        memory = f"{_total_memory(one) / MIB:.1f}"
        rows.append((number, *sums, p99, memory, f"{len(back)} of {soak['count']}", *_two(back)))
    columns = (
        "part | commands | lost | not sent | refusals told | connections that ended | p99, ms | memory, MiB | returned "
        "| p50, s | max, s"
    )
    return Section("For long", text, columns, rows)


def _total_memory(one_round: Values) -> int:
    return sum(one_round["memory_bytes"].values())


def memory_spread_percent(soak: Values) -> float:
    """How far memory moves from that of the second part, or of the only one: the first one fills caches."""
    totals = [_total_memory(one) for one in soak["rounds"]]
    totals = totals[1:] or totals
    return max(100.0 * abs(one - totals[0]) / totals[0] for one in totals)


def _comparisons(fleets: Sequence[Values]) -> Iterable[Comparison]:
    """The aims, beside the largest fleet that was measured."""
    if not fleets:
        return
    largest = fleets[-1]
    count = largest["count"]
    started, back = group(count, largest["start"]), group(count, largest["return"])
    found = [
        ("late or never back after all containers restart", 0.0, float(back.wanted - back.in_time)),
        ("back after all containers restart, p50", AIM_RETURN_P50_S, _median(back.message_s)),
        ("idle, server's processor a robot and s", AIM_IDLE_MS, idle_ms(started)),
        ("server's memory a robot", AIM_MEMORY_MIB, memory_mib(started)),
        ("a start, server's processor a robot", AIM_START_MS, start_ms(started)),
    ]
    units = ("robots", "s", "ms", "MiB", "ms")
    drives = largest["drive"].get("drives", [])
    p99 = _merged(drives, "round_trips").quantile_ms(0.99) if drives else None
    found.append((f"driven at {RATE_HZ} Hz: p99 there and back", AIM_DRIVE_P99_MS, p99))
    lost = float(sum(one["lost"] + one["unsent"] for one in drives)) if drives else None
    found.append((f"driven at {RATE_HZ} Hz: lost", 0.0, lost))
    for (what, aim, ours), unit in zip(found, (*units, "ms", "commands"), strict=True):
        yield against_aim(f"{count} robots, {what}", aim, ours, unit)


def _of_soaks(soaks: Sequence[Values]) -> Iterable[Comparison]:
    for soak in soaks:
        what = f"{soak['count']} robots for {soak['seconds'] / 60:.3g} minutes"
        if soak["rounds"]:
            yield against_aim(
                f"{what}: memory moves by", AIM_SOAK_PERCENT, memory_spread_percent(soak), "%"
            )
        yield against_aim(f"{what}: commands lost", 0.0, float(_soak_lost(soak)), "commands")


def _soak_lost(soak: Values) -> int:
    drives = (drive for one in soak["rounds"] for drive in one["drive"].get("drives", []))
    return sum(drive["lost"] + drive["unsent"] for drive in drives)


def _shortfalls(fleets: Sequence[Values], soaks: Sequence[Values]) -> Iterable[str]:
    for one in fleets:
        for what, run in (("start", one["start"]), ("return", one["return"])):
            some = group(one["count"], run)
            if missing := some.wanted - some.in_time:
                why = ", ".join(f"{words} ({times})" for words, times in some.waits.most_common(3))
                yield (
                    f"the {what} of {one['count']} robots: {missing} had no message within {FAILED_AFTER_S:g} s, "
                    f"{some.late} of them later; operators heard: {why or 'nothing'}"
                )
            yield from (f"the {what} of {one['count']} robots: {words}" for words in some.limits)
        if "failure" in one["drive"]:
            yield f"driving among {one['count']} robots: {one['drive']['failure']:.200}"
        else:
            yield from _reasons(one["count"], one["drive"]["drives"])
    for soak in soaks:
        gone = sum(len(one["message_s"]) - len(present(one["message_s"])) for one in soak["rounds"])
        if gone:
            yield f"in the soak {gone} returns of a robot brought no message"
        yield from (
            f"a part of the soak: {one['drive']['failure']:.200}"
            for one in soak["rounds"]
            if "failure" in one["drive"]
        )


def _reasons(count: int, drives: Sequence[Mapping[str, Any]]) -> Iterable[str]:
    for name, what in (("refused", "not passed on"), ("endings", "connections ended")):
        if told := _told(drives, name):
            words = ", ".join(f"{why} ({times})" for why, times in told.most_common(3))
            yield f"driving among {count} robots: {what}: {words}"


def _told(drives: Iterable[Mapping[str, Any]], name: str) -> Counter[str]:
    """What drivers were told of endings or refusals, and how often."""
    return sum((Counter(one[name]) for one in drives), Counter())


def _median(values: Sequence[float]) -> float | None:
    return float(quantile(values, 0.5)) if values else None


def _two(values: Sequence[float]) -> list[str]:
    return [fixed(_median(values), 2), fixed(max(values, default=None), 2)]


def _quantiles_ms(times: Histogram) -> list[str]:
    return [fixed(times.quantile_ms(part), 1) for part in (0.5, 0.99, 1.0)]


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _number(value: float | None) -> str:
    return NONE if value is None else f"{value:.3g}"
