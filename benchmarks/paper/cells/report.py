"""What the page says of cells, with the aims beside. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from numpy import quantile
from sections import Section, fixed

from paper.numbered.messages import Histogram
from paper.step import Comparison, Report, Results, Values, against_aim, succeeded

# Of issue 18.
AIM_RETURN_P99_S = 5.0
MOST_SHOWN = 10
# A driver who gives up before has not waited for long enough to tell.
PATIENT_S = 5.0


def report(results: Results) -> Report:
    """The part's report, of the steps that have run."""
    values = succeeded(results)
    makers = {
        "nemesis": _nemesis,
        "cell-killed": _killed,
        "database-away": _away,
        "drain": _drain,
        "forwarding": _forwarding,
    }
    sections = [make(values[name]) for name, make in makers.items() if name in values]
    if "nemesis" in values:
        sections.insert(1, _returns(values["nemesis"]["returns"]))
    spread = [one for name, one in values.items() if name.startswith("spread-")]
    if spread:
        sections.insert(-1 if "forwarding" in values else len(sections), _spread(spread))
    return Report(
        sections=sections,
        comparisons=list(_comparisons(values)),
        shortfalls=list(_shortfalls(values)),
    )


def times(returns: Sequence[Mapping[str, Any]]) -> list[float]:
    """Of robots that came back, and of those whose drivers waited for long in vain."""
    return [one["took_s"] for one in returns if one["came"] or one["took_s"] > PATIENT_S]


def _nemesis(run: Values) -> Section:
    size, seen, events = run["size"], run["seen"], run["events"]
    trips = Histogram.of(seen["round_trips"])
    most, last = run["crowds"]
    text = (
        f"{size['cells']} cells, {size['agents']} agents and {size['virtual']} virtual robots, "
        f"{size['drivers']} drivers at 20 Hz who go from robot to robot, {size['observers']} observers, "
        f"{size['operators']} operators who stop and release, and an admin who adds sites, for "
        f"{size['seconds'] / 60:.3g} minutes; each takes the next cell by itself when one fails. Meanwhile "
        f"{_counts(run['faults'])}. The seed is {run['seed']}. One or two things are broken at once, and one cell "
        "stays whole, unless the database is away. A clock is stepped for web and relay of a cell, by up to a minute; "
        "robots and the database keep the machine's."
        "\n\nThe rules: a robot is moved by one connection after the other and never by two in turns, never by an "
        "older fence after a newer one, and no fence is given twice; after a confirmed stop nothing moves until a "
        "release that was asked for after it; a command that moves is followed by another or a zero within 0.51 s "
        "and what held the process up; sessions' epochs grow; drives, stops and sites that the server confirmed are "
        "in the database, also when the relay that had them was killed while the database was away."
        f"\n\nDrivers sent {seen['sent']} commands and heard {seen['heard']}, p99 there and back "
        f"{fixed(trips.quantile_ms(0.99), 1)} ms. Observers got {seen['frames']} frames and {seen['messages']} "
        f"messages. {seen['confirmed_stops']} stops were confirmed at once. After the last fault all cells knew of "
        f"all robots within {run['online_s']:.1f} s. One cell had {most} robots at most, and at the end none had more "
        f"than {last}."
    )
    rows = [(name.replace("_", " "), count) for name, count in sorted(events.items())]
    return Section("Nemesis", text, "event | times", rows)


def _returns(returns: Sequence[Mapping[str, Any]]) -> Section:
    text = (
        "How long robots were not drivable by who wanted to, from when a live cell was there and the last fault of a "
        "cell had begun; a drain is one for the robots at that cell. An outage below 0.6 s is none. Who gives up "
        "within 5 s is left out."
    )
    by_cause: dict[str, list[Mapping[str, Any]]] = {}
    for one in returns:
        by_cause.setdefault(one["after"].replace("_", " ") or "no fault of a cell", []).append(one)
    rows = [
        (cause, len(took), *_quantiles(took))
        for cause, some in sorted(by_cause.items())
        if (took := times(some))
    ]
    return Section("Drivable again", text, "after | times | p50, s | p99, s | max, s", rows)


def _counts(faults: Mapping[str, int]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} ({count})" for name, count in faults.items())


def _killed(run: Values) -> Section:
    took = [one for one in run["took_s"] if one is not None]
    text = (
        f"All containers of a cell are killed, with {run['robots']} of {run['of']} robots on it. The time is from just "
        "before the kill until an operator at another cell has heard his own command of the robot. Meanwhile this "
        f"machine's processors worked for {sum(run['cpu_s'].values()):.1f} s: {_shares(run['cpu_s'])}."
    )
    rows = [(run["robots"], len(took), *_quantiles(took))]
    columns = "robots | drivable elsewhere | p50, s | p99, s | max, s"
    return Section("A cell is killed", text, columns, rows)


def _shares(cpu_s: Mapping[str, float]) -> str:
    """Who used the processor, most first; the services of all cells together."""
    used: dict[str, float] = {}
    for name, seconds in cpu_s.items():
        who = name.split()[0]
        used[who] = used.get(who, 0.0) + seconds
    most_first = sorted(used, key=lambda who: -used[who])
    return ", ".join(f"{who} {used[who]:.1f}" for who in most_first)


def _away(run: Values) -> Section:
    begun = [one for one in run["begun"] if one["began"]]
    open_ones = run["open"]
    text = (
        f"The database is killed for {run['away_s']:g} s. Drives that are open go on; other drives begin at once, by "
        "tickets from before, and again 10 s before it is back, by new tickets. Without the database "
        f"{run['fresh_tickets']} of {len(run['begun']) // 2} tickets were given. The records of drives that began "
        "meanwhile are written later."
    )
    rows = [
        (
            len(open_ones),
            *(sum(one[name] for one in open_ones) for name in ("sent", "lost", "unsent")),
            sum(Counter(one["endings"]).total() for one in open_ones),
            f"{len(begun)} of {len(run['begun'])}",
            f"{run['recorded']} of {len(begun)}",
        )
    ]
    columns = (
        "open drives | commands | lost | not sent | ended | other drives began | recorded later"
    )
    return Section("The database is away", text, columns, rows)


def _drain(run: Values) -> Section:
    drives = run["drives"]
    text = (
        f"A cell with {run['robots']} robots is drained; {len(drives)} of them are driven at 20 Hz for "
        f"{run['drive_s']:g} s meanwhile, and go when their drives end. Empty is when the last one has gone, from the "
        "order on."
    )
    lost = [sum(one[name] for one in drives) for name in ("sent", "lost", "unsent")]
    ended = sum(Counter(one["endings"]).total() for one in drives)
    rows = [(len(drives), *lost, ended, fixed(run["empty_s"], 1))]
    columns = "driven | commands | lost | not sent | connections that ended | empty after, s"
    return Section("A cell is drained", text, columns, rows)


def carried_a_s(run: Values) -> float:
    return sum(one["sent"] - one["lost"] for one in run["drives"]) / float(run["seconds"])


def _spread(runs: Sequence[Values]) -> Section:
    text = (
        f"Each cell has {runs[0]['share']:.3g} of a core for all its containers, as a machine of its own would have "
        "its own processor; cells that do not take part are off. All robots start at once; then some of each cell "
        "are driven at 50 Hz, more than it carries. The database, the robots and the drivers share what is left of "
        "this machine."
    )
    first = runs[0]
    rows = []
    for run in runs:
        robots_a_s = run["robots"] / run["online_s"]
        rows.append(
            (
                run["cells"],
                run["robots"],
                f"{run['online_s']:.1f}",
                f"{robots_a_s:.2f}",
                f"{carried_a_s(run):.0f}",
                f"{_ratio(carried_a_s(run), carried_a_s(first)):.2f}",
                " / ".join(f"{one / run['seconds']:.2f}" for one in run["cpu_s"]),
            )
        )
    columns = "cells | robots | all online, s | robots a s | commands heard a s | times one cell | cores used"
    return Section("One, two, three cells", text, columns, rows)


def _ratio(value: float, of: float) -> float:
    return value / of if of else float("nan")


def _forwarding(run: Values) -> Section:
    text = (
        f"{run['bytes']} bytes to a robot and back through its own cell, and through another one that forwards, in "
        "turns. Forwarded, a message passes one more nginx each way."
    )
    rows = []
    for name, words in (("own", "its own cell"), ("other", "another cell")):
        trips = Histogram.of(run[name])
        quantiles = (fixed(trips.quantile_ms(part), 2) for part in (0.5, 0.99, 1.0))
        rows.append((words, trips.total, *quantiles))
    return Section(
        "What forwarding costs", text, "through | messages | p50, ms | p99, ms | max, ms", rows
    )


def _comparisons(values: Mapping[str, Values]) -> Iterator[Comparison]:
    if run := values.get("nemesis"):
        yield _exactly("rules broken under the nemesis", float(run["broken"]), "times")
        yield _exactly("processes and robots that failed", float(len(run["failed"])), "times")
        # Without any, nobody was ever kept from driving.
        late = _quantile(times(run["returns"]) or [0.0], 0.99)
        yield against_aim(
            "drivable again once a live cell is there, p99", AIM_RETURN_P99_S, late, "s"
        )
    if run := values.get("cell-killed"):
        took = [one for one in run["took_s"] if one is not None]
        never = float(len(run["took_s"]) - len(took))
        yield _exactly("robots of a killed cell that never came back", never, "robots")
        yield against_aim(
            "drivable elsewhere after a cell is killed, p99",
            AIM_RETURN_P99_S,
            _quantile(took, 0.99),
            "s",
        )
    if run := values.get("database-away"):
        open_ones, begun = run["open"], [one for one in run["begun"] if one["began"]]
        ended = sum(Counter(one["endings"]).total() for one in open_ones)
        yield against_aim(
            "open drives that ended without the database", 0.0, float(ended), "drives"
        )
        lost = float(sum(one["lost"] + one["unsent"] for one in open_ones))
        yield against_aim("commands lost without the database", 0.0, lost, "commands")
        missing = float(len(run["begun"]) - len(begun))
        yield against_aim("drives that did not begin without the database", 0.0, missing, "drives")
        unwritten = float(len(begun) - run["recorded"])
        yield against_aim(
            "drives without the database that were not recorded later", 0.0, unwritten, "drives"
        )
    if run := values.get("drain"):
        lost = float(sum(one["lost"] + one["unsent"] for one in run["drives"]))
        yield against_aim("commands lost in a drain", 0.0, lost, "commands")
        left = 0.0 if run["empty_s"] is not None else 1.0
        yield against_aim("drains that left robots behind", 0.0, left, "drains")


def _shortfalls(values: Mapping[str, Values]) -> Iterator[str]:
    if run := values.get("nemesis"):
        for one in run["violations"][:MOST_SHOWN]:
            yield f"{one['rule']}: {one['robot']}: {one['words']}"
        if run["kept"]:
            yield f"the history of seed {run['seed']} is in {run['kept']}"
        for words, count in Counter(run["failed"]).most_common(MOST_SHOWN):
            yield f"{count} times: {words}"
        if ignored := run["ignored_stops_s"]:
            yield (
                f"{len(ignored)} stops were taken by a cell that could not reach the robot's, and answered as not "
                f"confirmed; the robot was moved for up to {max(ignored):.1f} s more"
            )
        gave_up = sum(not one["came"] and one["took_s"] > PATIENT_S for one in run["returns"])
        if gave_up:
            yield f"{gave_up} times a driver gave up before a robot was drivable again"
    if run := values.get("database-away"):
        why = Counter(one["why"] for one in run["begun"] if not one["began"])
        for words, count in why.most_common(3):
            yield f"without the database {count} drives did not begin: {words:.200}"


def _exactly(what: str, ours: float, unit: str) -> Comparison:
    """What fails the run."""
    return Comparison(
        what=what, against="rule", reference=0.0, ours=ours, unit=unit, better="equal"
    )


def _quantile(values: Sequence[float], part: float) -> float | None:
    return float(quantile(values, part)) if values else None


def _quantiles(values: Sequence[float]) -> list[str]:
    return [fixed(_quantile(values, part), 2) for part in (0.5, 0.99, 1.0)]
