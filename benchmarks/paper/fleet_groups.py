"""The outcomes of starts and returns, by what was run: what tables, figures and files are made of. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

from paper.step import Outcome, Results, Values

Kind = Literal["start", "whole", "reconnect"]
KINDS: tuple[Kind, ...] = ("start", "whole", "reconnect")
# A robot without a message after this has failed, whatever comes later.
FAILED_AFTER_S = 60.0


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
        """How many got it later than that."""
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
        """Which limits of containers were met."""
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
    """How many robots got a message."""
    return len(present(run["message_s"]))


def present(values: Iterable[float | None]) -> list[float]:
    """Those that there are."""
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
