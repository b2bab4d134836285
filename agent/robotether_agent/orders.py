"""The session's lines about driving, each handed on in the moment in which it comes.

Used by robotether_agent.session on the connection that carries control; the keeper of the guard does what they say.
Never holds one back and never drops a stop for what it lacks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Protocol

from robotether_agent.fields import JsonObject, get_flag, get_int, get_match, get_text

LAST_FENCE = 2**63 - 1
ORDER = re.compile(r"[A-Za-z0-9_-]{1,64}")
SOMEBODY = "somebody"


class Orders(Protocol):
    """Who does what the server says about driving."""

    def configured(self, wants: JsonObject, *, direct: bool) -> None:
        """The session stands, and `wants` is what the guard goes by."""

    def lease(self, fence: int, *, held: bool) -> None:
        """The newest fencing number, and whether it is held; if not, all up to it are over."""

    def stop(self, order: str, by: str) -> None:
        """Stop the robot; the answer names `order`."""

    def release(self, order: str, by: str) -> None:
        """Let a stopped robot be driven again; the answer names `order`."""


def handlers(orders: Orders) -> Mapping[str, Callable[[JsonObject], None]]:
    """Return what reads each kind of line; they raise FieldError."""

    def lease(message: JsonObject) -> None:
        fence = get_int(message, "fence", 0, LAST_FENCE)
        orders.lease(fence, held=get_flag(message, "held", default=False))

    def stop(message: JsonObject) -> None:
        order = get_text(message, "id", default="")
        orders.stop(order, get_text(message, "by", default=SOMEBODY))

    def release(message: JsonObject) -> None:
        order = get_match(message, "id", ORDER, "a short id")
        orders.release(order, get_text(message, "by", default=SOMEBODY))

    return {"lease": lease, "stop": stop, "release": release}
