"""What is ticked in a list, for one action on all of it after one question.

GET has it as it is ticked (`robot` or `user`, several times), also that of the list itself, whose other pages so keep
it. The answer sends it back in one field.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from urllib.parse import urlencode

from flask import Blueprint, request

from robotether_server.db import Transaction
from robotether_server.db.audit import Source
from robotether_server.problems import FieldInvalidError
from robotether_server.web import confirmation
from robotether_server.web.admin import grants
from robotether_server.web.confirmation import ConfirmedAction, Words

# Maximum number of names, which all stand in an address of 8 KB.
MAX_TICKED = 100


@dataclass(frozen=True)
class Selection:
    """The boxes of one list; `noun` is their name, and what is ticked."""

    noun: str

    @property
    def many(self) -> str:
        """The field with all of it."""
        return f"{self.noun}s"

    def names(self) -> list[str]:
        """Return what is ticked; raise FieldInvalidError for nothing, or too much."""
        names = request.values.get(self.many, "").split() or request.args.getlist(self.noun)
        if not names:
            raise FieldInvalidError(f"cannot continue: tick at least one {self.noun}", self.noun)
        names = list(dict.fromkeys(names))
        if len(names) > MAX_TICKED:
            raise FieldInvalidError(
                f"cannot continue: tick at most {MAX_TICKED} {self.many} at once", self.noun
            )
        return names

    def of_list(self, names: Iterable[str]) -> list[str]:
        """Return what the list has ticked, in its order; what was renamed or removed meanwhile is left out."""
        ticked = set(request.args.getlist(self.noun))
        return [name for name in names if name in ticked][:MAX_TICKED]

    def words(self) -> dict[str, object]:
        """Return what the texts of actions name: the ticked, their number, and the query that has them ticked again."""
        names = self.names()
        return {
            self.many: " ".join(names),
            "names": ", ".join(names),
            "count": f"1 {self.noun}" if len(names) == 1 else f"{len(names)} {self.many}",
            "ticked": urlencode([(self.noun, name) for name in names]),
        }

    def each(self, do: Callable[[Transaction, Source, str], object]) -> Callable[..., object]:
        """Return what does this to each that is ticked."""
        return lambda tx, source: [do(tx, source, name) for name in self.names()]

    def register(
        self, blueprint: Blueprint, find: Callable[[], Words], *actions: ConfirmedAction
    ) -> None:
        """Register actions that name and send what is ticked, and go on to the list with nothing ticked.

        `find` returns what else their texts may name.
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
            return {**self.words(), **_grant_words(), **find()}

        confirmation.register(blueprint, f"/admin/{self.many}?{{ticked}}", words, *of_all)


def _grant_words() -> Words:
    """Return what the texts name of a grant's level and end."""
    hours = request.values.get("hours", "")
    end = f", for {dict(grants.ENDS).get(hours, hours)}" if hours else ""
    return {"level": request.values.get("level", ""), "hours": hours, "end": end}
