"""What is ticked in a list, for one action on all of it after one question.

GET has it as it is ticked (`robot` or `user`, several times), also that of the list itself, whose other pages so keep
it. The answer sends it back in one field. A robot is ticked by its MAC: another one may get its name meanwhile.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from urllib.parse import urlencode

from flask import Blueprint, request

from robotether_server.api.context import context
from robotether_server.db import Transaction
from robotether_server.db.audit import Source
from robotether_server.db.grants import LEVELS
from robotether_server.problems import FieldInvalidError
from robotether_server.web import confirmation
from robotether_server.web.admin import grants
from robotether_server.web.confirmation import ConfirmedAction, Words

# Maximum number of boxes, which all stand in an address of 8 KB.
MAX_TICKED = 100


@dataclass(frozen=True)
class Selection:
    """The boxes of one list; `noun` is their name, and what is ticked.

    `read_names` returns the names by the values of the boxes; a value without one is a name.
    """

    noun: str
    read_names: Callable[[Transaction], Mapping[str, str]] = lambda _tx: {}

    @property
    def many(self) -> str:
        """The field with all of it."""
        return f"{self.noun}s"

    def _values(self) -> list[str]:
        """Return the values of the ticked boxes; raise FieldInvalidError for none, or too many."""
        values = request.values.get(self.many, "").split() or request.args.getlist(self.noun)
        if not values:
            raise FieldInvalidError(f"cannot continue: tick at least one {self.noun}", self.noun)
        values = list(dict.fromkeys(values))
        if len(values) > MAX_TICKED:
            raise FieldInvalidError(
                f"cannot continue: tick at most {MAX_TICKED} {self.many} at once", self.noun
            )
        return values

    def names(self, tx: Transaction) -> list[str]:
        """Return the names of what is ticked; raise FieldInvalidError for nothing, or too much."""
        names = self.read_names(tx)
        return [names.get(value, value) for value in self._values()]

    def of_list(self, values: Iterable[str]) -> list[str]:
        """Return what the list has ticked, in its order; what was removed meanwhile is left out."""
        ticked = set(request.args.getlist(self.noun))
        return [value for value in values if value in ticked][:MAX_TICKED]

    def _words(self, names: list[str]) -> Words:
        """Return what the texts of actions name: the ticked, their number, and the query that has them ticked again."""
        values = self._values()
        return {
            self.many: " ".join(values),
            "names": ", ".join(names),
            "count": f"1 {self.noun}" if len(names) == 1 else f"{len(names)} {self.many}",
            "ticked": urlencode([(self.noun, value) for value in values]),
        }

    def each(self, do: Callable[[Transaction, Source, str], object]) -> Callable[..., object]:
        """Return what does this to each that is ticked."""
        return lambda tx, source: [do(tx, source, name) for name in self.names(tx)]

    def register(
        self,
        blueprint: Blueprint,
        find: Callable[[Transaction, list[str]], Words],
        *actions: ConfirmedAction,
    ) -> None:
        """Register actions that name and send what is ticked, and go on to the list with nothing ticked.

        `find` returns what else their texts may name, from the names of what is ticked.
        """
        of_all = (
            replace(
                action,
                effects=("{names}", *action.effects),
                hidden=((self.many, f"{{{self.many}}}"), *action.hidden),
                onward=f"/admin/{self.many}",
            )
            for action in actions
        )

        def words() -> Words:
            with context().database.transaction() as tx:
                names = self.names(tx)
                return {**self._words(names), **_grant_words(), **find(tx, names)}

        confirmation.register(blueprint, f"/admin/{self.many}?{{ticked}}", words, *of_all)


def _grant_words() -> Words:
    """Return what the texts name of a grant's level and end; raise FieldInvalidError for others than the list has."""
    level, hours = request.values.get("level", ""), request.values.get("hours", "")
    ends = dict(grants.ENDS)
    if level not in {"", *LEVELS} or hours not in ends:
        raise FieldInvalidError("cannot continue: choose level and end in the list", "level")
    return {"level": level, "hours": hours, "end": f", for {ends[hours]}" if hours else ""}
