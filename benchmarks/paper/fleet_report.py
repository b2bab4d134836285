"""What the page says of starts and returns: how many got their message, how soon, at what cost. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from sections import Section, quantile

from paper.fleet_groups import FAILED_AFTER_S, Group, groups
from paper.fleet_plots import plots
from paper.reconnect import IN_WORDS
from paper.step import Comparison, Data, Report, Results, failures
from paper.words import number, plain

NONE = "-"
SERVER = ("nginx", "web", "relay", "sshd", "mysql")
OTHERS = tuple(name for name in SERVER if name not in ("relay", "sshd"))
MIB = 1024 * 1024


def report(planned: Sequence[str], results: Results) -> Report:
    """The part's report; `planned` are the names of all steps of this scale."""
    found = groups(planned, results)
    starts = [group for group in found if group.kind != "reconnect"]
    returns = [group for group in found if group.kind == "reconnect"]
    return Report(
        sections=[_starts(starts), _costs(starts), _returns(returns)],
        comparisons=_comparisons(found),
        plots=plots(starts, returns),
        data=[_data("starts", starts), _data("returns", returns)],
        shortfalls=[*failures(results), *_shortfalls(found)],
    )


def title(group: Group) -> str:
    """`50`, or `50 whole`."""
    return f"{group.count} whole" if group.kind == "whole" else str(group.count)


def _starts(starts: Sequence[Group]) -> Section:
    text = (
        "All robots are told to start at the same time. When the server's events report one online, an "
        "operator gets a ticket, connects to drive through nginx and TLS, and publishes one "
        "std_msgs/String with robot and run. A subscriber on the robot's ROS side receives it: the time "
        "is from the order to start until then. An operator whom the server cannot connect yet tries "
        f"again, within that time. A robot without its message after {FAILED_AFTER_S:g} s has failed, even "
        "if it comes later. Light robots are the real agent and guard, some 25 to 50 in a process, each "
        "with two OpenSSH connections of its own and a rosbridge. Those of one process share an address. "
        "Unlike whole robots, they do not start a Python and a guard process each. Robots, operators and "
        "server share this machine's cores."
    )
    head = (
        "| robots at once | runs | message in time | later | never | p50, s | p99, s | max, s | online p50, s "
        "| tried again | wrong robot | doubled |"
    )
    return Section("Starts", text, [head, _rule(head), *map(_start_row, starts)])


def _start_row(group: Group) -> str:
    cells = [
        title(group),
        f"{len(group.outcomes)} of {group.planned}",
        f"{group.in_time} of {group.wanted}",
        str(group.late),
        str(group.never),
        *_three(group.message_s),
        _quantile(group.online_s, 0.5),
        str(group.waits.total()),
        str(group.wrong),
        str(group.doubled),
    ]
    return _row(cells)


def _costs(starts: Sequence[Group]) -> Section:
    text = (
        "For each robot that came online: processor time from the order to start until the last message, "
        "and the memory that the server's containers had gained by then, from their control groups (the "
        "programs' pages and the kernel's for them). The robots' side is agents, guards, rosbridges and "
        "OpenSSH clients. They run at the lowest priority (nice 19), because real robots have processors "
        "of their own. The rest is this machine's other work, such as Docker, the kernel's network and "
        "other programs. Idle is the whole fleet, online and unused."
    )
    head = (
        "| robots at once | cores busy | CPU a robot, ms: sshd | relay | nginx, web, database | robots' side | "
        "operators | rest | memory a robot, MiB: sshd | relay | nginx, web, database | idle, % of a core: server | "
        "robots' side | limits met |"
    )
    return Section("What a start costs", text, [head, _rule(head), *map(_cost_row, starts)])


def _cost_row(group: Group) -> str:
    parts = (("sshd",), ("relay",), OTHERS)
    cpu = [*parts, ("robots",), ("operators",), ("rest",)]
    cells = [
        title(group),
        _scaled(group.busy_cores, 1),
        *(_scaled(group.per_robot("cpu_s", names), 1000) for names in cpu),
        *(_scaled(group.per_robot("memory_bytes", names), 1 / MIB) for names in parts),
        *(_scaled(group.idle_load(names), 100) for names in (SERVER, ("robots",))),
        plain("; ".join(group.limits)) or "none",
    ]
    return _row(cells)


def _returns(returns: Sequence[Group]) -> Section:
    text = (
        "The containers of an online fleet's server are killed and started again. The time is from just "
        "before the kill until a robot has received a message that an operator sent afterwards. The "
        "server answers when it reports its fleet again. Nobody tells the agents: they notice, and "
        "reconnect by themselves."
    )
    head = (
        "| restarted | robots | back in time | later | never | server answers, s | p50, s | p99, s | max, s "
        "| tried again |"
    )
    return Section("Returns", text, [head, _rule(head), *map(_return_row, returns)])


def _return_row(group: Group) -> str:
    answers = [run["server_s"] for run in group.runs if run["server_s"] is not None]
    cells = [
        IN_WORDS[group.what],
        str(group.count),
        f"{group.in_time} of {group.wanted}",
        str(group.late),
        str(group.never),
        number(max(answers)) if answers else NONE,
        *_three(group.message_s),
        str(group.waits.total()),
    ]
    return _row(cells)


def _comparisons(found: Sequence[Group]) -> list[Comparison]:
    """The paper's own figure, and what must hold for as many: the smallest fleets; a larger one is a question."""
    smallest = min((group.count for group in found), default=0)
    rows = [
        _percent(group, _what(group), "paper" if group.kind == "start" else "all")
        for group in found
        if group.count == smallest and group.outcomes and group.kind != "whole"
    ]
    measured = [group for group in found if group.runs]
    if measured:
        wrong = sum(group.wrong for group in measured)
        rows.append(
            Comparison(
                what="messages that reached another robot",
                against="none",
                reference=0,
                ours=wrong,
                unit="",
                better="equal",
            )
        )
    return rows


def _what(group: Group) -> str:
    if group.kind == "start":
        return f"robots that got their message, {group.count} at once, {len(group.outcomes)} times"
    return f"robots that came back after a restart of {IN_WORDS[group.what]}, {group.count} at once"


def _percent(group: Group, what: str, against: str) -> Comparison:
    return Comparison(
        what=what, against=against, reference=100.0, ours=group.success, unit="%", better="equal"
    )


def _shortfalls(found: Sequence[Group]) -> Iterable[str]:
    for group in found:
        runs = f"{len(group.outcomes)} of {group.planned} runs"
        where = (
            f"the return after a restart of {IN_WORDS[group.what]}"
            if group.kind == "reconnect"
            else "the start"
        )
        missing = group.wanted - group.in_time
        if missing:
            yield (
                f"{where} of {title(group)} robots: {missing} of {group.wanted} had no message within "
                f"{FAILED_AFTER_S:g} s, {group.late} of them later ({runs}){_reasons(group)}"
            )
        for words in group.limits:
            yield f"{where} of {title(group)} robots: {words}"


def _reasons(group: Group) -> str:
    """What operators heard most while they waited, and an agent's last words."""
    common = [f"{why} ({times})" for why, times in group.waits.most_common(3)]
    on_message = f"; operators heard: {', '.join(common)}" if common else ""
    words = group.last_words
    return f"{on_message}; an agent said last: {words:.200}" if words else on_message


def _data(name: str, found: Sequence[Group]) -> Data:
    rows = [
        (title(group), group.what, run_number, online, message)
        for group in found
        for run_number, run in enumerate(group.runs, 1)
        for online, message in zip(run["online_s"], run["message_s"], strict=True)
    ]
    return Data(
        name=name,
        about="seconds until the server called a robot online, and until the robot had its message; empty: never. One "
        "row a robot and run",
        header=("robots at once", "restarted", "run", "online, s", "message, s"),
        rows=rows,
    )


def _three(values: Sequence[float]) -> list[str]:
    return [_quantile(values, part) for part in (0.5, 0.99, 1.0)]


def _quantile(values: Sequence[float], part: float) -> str:
    return f"{quantile(values, part):.2f}" if values else NONE


def _scaled(value: float | None, factor: float) -> str:
    return NONE if value is None else f"{value * factor:.3g}"


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _rule(head: str) -> str:
    return "|" + "---|" * (head.count("|") - 1)
