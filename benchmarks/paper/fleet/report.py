"""What the page says of starts and returns: how many robots got their message, how soon, at what cost. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Literal

from numpy import quantile
from sections import NONE, Section, fixed, number, plain

from paper.step import Comparison, Data, Outcome, Plot, Report, Results, Values

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

Kind = Literal["start", "whole", "reconnect"]
KINDS: tuple[Kind, ...] = ("start", "whole", "reconnect")
# A robot without a message after this has failed, whatever comes later.
FAILED_AFTER_S = 60.0
STARTS = (
    "Share of the robots that had their first message, by the time since all were told to start, over all "
    "repetitions. A curve that does not reach 100 % belongs to a fleet of which some robots never got it; the dotted "
    "line is where one counts as failed."
)
RETURNS = (
    "Share of the robots that had a message again, by the time since the server's containers were killed. The dotted "
    "line is where a robot counts as failed."
)
# What was restarted.
IN_WORDS = {"tunnels": "sshd and relay", "server": "all containers, as when the VM restarts"}
# How many of a fleet are the real agent; all more are virtual robots.
AGENTS = 50
SERVER = ("nginx", "web", "relay", "sshd", "mysql")
OTHERS = tuple(name for name in SERVER if name not in ("relay", "sshd"))
MIB = 1024 * 1024


@dataclass(frozen=True)
class Group:
    """All runs of one kind and size; `what` names what was restarted, for returns."""

    kind: Kind
    count: int
    what: str
    planned: int
    outcomes: Sequence[Outcome] = field(default=())

    @property
    def runs(self) -> list[Values]:
        """What was measured in the runs that did not fail as a whole."""
        return [one.values for one in self.outcomes if one.values is not None]

    @property
    def wanted(self) -> int:
        """How many messages robots should have got in all runs, those that failed as a whole included."""
        return self.count * len(self.outcomes)

    @property
    def message_s(self) -> list[float]:
        """Seconds to the first message, of each robot that got one."""
        return present(one for run in self.runs for one in run["message_s"])

    @property
    def online_s(self) -> list[float]:
        """Seconds until the server called a robot online."""
        return present(one for run in self.runs for one in run["online_s"])

    @property
    def in_time(self) -> int:
        """How many robots got their message before they count as failed."""
        return sum(seconds <= FAILED_AFTER_S for seconds in self.message_s)

    @property
    def late(self) -> int:
        return len(self.message_s) - self.in_time

    @property
    def never(self) -> int:
        """How many robots got none at all, also of runs that failed."""
        return self.wanted - len(self.message_s)

    @property
    def success(self) -> float:
        """The share in percent of robots that got their message in time."""
        return 100.0 * self.in_time / self.wanted if self.wanted else 0.0

    @property
    def wrong(self) -> int:
        """How many messages reached another robot than they were for."""
        return sum(run["wrong"] for run in self.runs)

    @property
    def doubled(self) -> int:
        """How many robots got more than one message, as an operator took one for lost."""
        return sum(max(0, run["received"] - got(run)) for run in self.runs)

    @property
    def waits(self) -> Counter[str]:
        """Why operators had to try again, by the server's words."""
        return sum((Counter(run["waits"]) for run in self.runs), Counter())

    @property
    def limits(self) -> list[str]:
        return sorted({words for run in self.runs for words in run["limits"]})

    def per_robot(self, values: str, names: Iterable[str]) -> float | None:
        """The mean a robot of some members of `cpu_s` or `memory_bytes`; None without a robot online."""
        robots = sum(len(present(run["online_s"])) for run in self.runs)
        names = tuple(names)
        total = sum(run[values].get(name, 0) for run in self.runs for name in names)
        return total / robots if robots else None

    @property
    def busy_cores(self) -> float | None:
        """How many cores were busy on the mean, with whatever, from the order to the last message."""
        used = sum(sum(run["cpu_s"].values()) for run in self.runs)
        took = sum(run["took_s"] for run in self.runs)
        return used / took if took else None

    @property
    def last_words(self) -> str:
        """What an agent said last in a run in which some robot never got its message; mostly why."""
        said = (lines for run in self.runs for lines in run["failures"])
        return next((lines.splitlines()[-1] for lines in said if lines), "")

    def idle_load(self, names: Sequence[str]) -> float | None:
        """Cores that some members of `idle_cpu_s` keep busy while nobody uses the fleet; None: not measured."""
        measured = [run for run in self.runs if "idle_s" in run]
        used = sum(run["idle_cpu_s"].get(name, 0.0) for run in measured for name in names)
        return used / sum(run["idle_s"] for run in measured) if measured else None


def got(run: Values) -> int:
    return len(present(run["message_s"]))


def present(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def groups(planned: Sequence[str], results: Results) -> list[Group]:
    """One for each kind, size and restart, in the order in which they are planned; also where nothing has run yet."""
    found: dict[tuple[Kind, int, str], list[str]] = {}
    for name in planned:
        found.setdefault(_key(name), []).append(name)
    return [
        Group(kind, count, what, len(names), [results[name] for name in names if name in results])
        for (kind, count, what), names in found.items()
    ]


def _key(name: str) -> tuple[Kind, int, str]:
    """What a step's name says: start-50-7, whole-50 or reconnect-50-server."""
    word, count, *rest = name.split("-")
    kind = next(kind for kind in KINDS if kind == word)
    return kind, int(count), rest[0] if kind == "reconnect" else ""


def plots(starts: Sequence[Group], returns: Sequence[Group]) -> list[Plot]:
    """One figure each, of what has been measured."""
    wanted = (("startup-times", STARTS, starts), ("startup-returns", RETURNS, returns))
    return [
        Plot(name=name, caption=caption, draw=partial(draw, found=some))
        for name, caption, found in wanted
        if (some := [group for group in found if group.message_s])
    ]


def draw(drawing: Drawing, *, found: Sequence[Group]) -> None:
    axes = drawing.subplots()
    for group in found:
        times = sorted(group.message_s)
        shares = [100.0 * number / group.wanted for number in range(1, len(times) + 1)]
        axes.step([times[0], *times], [0.0, *shares], where="post", label=label(group))
    axes.axvline(FAILED_AFTER_S, color="grey", linestyle=":")
    axes.set_xscale("log")
    axes.set_xlabel("seconds")
    axes.set_ylabel("robots with a message, %")
    axes.set_ylim(0, 102)
    axes.legend(loc="lower right")


def label(group: Group) -> str:
    if group.kind == "reconnect":
        return f"{group.count} robots, {IN_WORDS[group.what]}"
    whole = "whole " if group.kind == "whole" else ""
    return f"{group.count} {whole}robots at once, {len(group.runs)} run(s)"


def report(planned: Sequence[str], results: Results) -> Report:
    """The part's report; `planned` are the names of all steps of this scale."""
    found = groups(planned, results)
    starts = [group for group in found if group.kind != "reconnect"]
    returns = [group for group in found if group.kind == "reconnect"]
    return Report(
        sections=[_starts(starts), _costs(starts), _returns(returns)],
        comparisons=_comparisons(found),
        plots=plots(starts, returns),
        data=[_data("startup-starts", starts), _data("startup-returns", returns)],
        shortfalls=list(_shortfalls(found)),
    )


def title(group: Group) -> str:
    """`50`, `50 whole`, or `200, 50 of them agents`."""
    if group.kind == "whole":
        return f"{group.count} whole"
    return str(group.count) + (f", {AGENTS} of them agents" if group.count > AGENTS else "")


def _starts(starts: Sequence[Group]) -> Section:
    text = (
        "All robots are told to start at the same time. When the server's events report one online, an operator gets a "
        "ticket, connects to drive through nginx and TLS, and publishes one std_msgs/String with robot and run. The "
        "time is from the order to start until a subscriber on the robot's ROS side has it. An operator whom the "
        "server cannot connect yet tries again, within that time. A robot without its message after "
        f"{FAILED_AFTER_S:g} s has failed, even if it comes later. The first {AGENTS} robots of a fleet are light "
        "ones: the real agent and guard, some 25 to 50 in a process, each with two OpenSSH connections of its own and "
        "a rosbridge. All more are virtual: they say what an agent says, 100 in a process, without what a robot's "
        "programs cost. Those of one process share an address. Whole robots start a Python and a guard process each. "
        "Robots, operators and server share this machine's cores."
    )
    columns = (
        "robots at once | runs | message in time | later | never | p50, s | p99, s | max, s | online p50, s "
        "| tried again | wrong robot | doubled"
    )
    return Section("Starts", text, columns, [_start_row(group) for group in starts])


def _start_row(group: Group) -> Sequence[object]:
    return (
        title(group),
        f"{len(group.outcomes)} of {group.planned}",
        f"{group.in_time} of {group.wanted}",
        group.late,
        group.never,
        *_three(group.message_s),
        _quantile(group.online_s, 0.5),
        group.waits.total(),
        group.wrong,
        group.doubled,
    )


def _costs(starts: Sequence[Group]) -> Section:
    text = (
        "For each robot that came online: processor time from the order to start until the last message, and the "
        "memory that the server's containers had gained by then, from their control groups (the programs' pages and "
        "the kernel's for them). The robots' side is agents, guards, rosbridges and OpenSSH clients; they start at the "
        "lowest priority (nice 19), because real robots have processors of their own, and have the normal one as soon "
        "as all are there. The rest is this machine's other work. Idle is the whole fleet, online and unused."
    )
    columns = (
        "robots at once | cores busy | CPU a robot, ms: sshd | relay | nginx, web, database | robots' side "
        "| operators | rest | memory a robot, MiB: sshd | relay | nginx, web, database | idle, % of a core: server "
        "| robots' side | limits met"
    )
    return Section("What a start costs", text, columns, [_cost_row(group) for group in starts])


def _cost_row(group: Group) -> Sequence[object]:
    parts = (("sshd",), ("relay",), OTHERS)
    cpu = [*parts, ("robots",), ("operators",), ("rest",)]
    return (
        title(group),
        _scaled(group.busy_cores, 1),
        *(_scaled(group.per_robot("cpu_s", names), 1000) for names in cpu),
        *(_scaled(group.per_robot("memory_bytes", names), 1 / MIB) for names in parts),
        *(_scaled(group.idle_load(names), 100) for names in (SERVER, ("robots",))),
        plain("; ".join(group.limits)) or "none",
    )


def _returns(returns: Sequence[Group]) -> Section:
    text = (
        "The containers of an online fleet's server are killed and started again. The time is from just "
        "before the kill until a robot has received a message that an operator sent afterwards. The "
        "server answers when it reports its fleet again. Nobody tells the agents: they notice, and "
        "reconnect by themselves."
    )
    columns = (
        "restarted | robots | back in time | later | never | server answers, s | p50, s | p99, s | max, s "
        "| tried again"
    )
    return Section("Returns", text, columns, [_return_row(group) for group in returns])


def _return_row(group: Group) -> Sequence[object]:
    answers = [run["server_s"] for run in group.runs if run["server_s"] is not None]
    return (
        IN_WORDS[group.what],
        group.count,
        f"{group.in_time} of {group.wanted}",
        group.late,
        group.never,
        number(max(answers)) if answers else NONE,
        *_three(group.message_s),
        group.waits.total(),
    )


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
    return fixed(quantile(values, part) if values else None, 2)


def _scaled(value: float | None, factor: float) -> str:
    return NONE if value is None else f"{value * factor:.3g}"
