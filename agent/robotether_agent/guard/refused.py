"""Why the guard refuses a message; raised by every check, counted and answered by the client proxy."""

from __future__ import annotations

from typing import Literal, get_args

# old: its age; fence: another one's lease; stopped: the latch; shape: what it says; held: nobody may drive now.
Kind = Literal["old", "fence", "stopped", "shape", "held"]
KINDS: tuple[Kind, ...] = get_args(Kind)


class Refused(Exception):  # noqa: N818 - the word of the protocol
    """`why` goes on where "cannot DO WHAT: " ends."""

    def __init__(self, kind: Kind, why: str) -> None:
        super().__init__(why)
        self.kind = kind
        self.why = why
