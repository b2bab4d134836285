"""Why the guard refuses a message; raised by every check, counted and answered by the client proxy."""

from __future__ import annotations

from robotether_common.guard import RefusedKind


class Refused(Exception):  # noqa: N818 - the word of the protocol
    """`why` goes on where "cannot DO WHAT: " ends."""

    def __init__(self, kind: RefusedKind, why: str) -> None:
        super().__init__(why)
        self.kind = kind
        self.why = why
