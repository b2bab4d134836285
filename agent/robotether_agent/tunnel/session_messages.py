"""The session's lines about driving, each handed on in the moment in which it comes.

Used by the session on the connection that carries control; the guard's supervisor does what they say.
Never holds one back and never drops a stop for what it lacks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Protocol

from robotether_agent.fields import JsonObject, get_flag, get_int, get_match, get_text

MAX_FENCE = 2**63 - 1
MESSAGE_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
SOMEBODY = "somebody"


class DriveMessageHandler(Protocol):
    """Who does what the server says about driving."""

    def on_config(self, guard: JsonObject, *, direct: bool) -> None:
        """The session stands, and `guard` is what the guard goes by."""

    def on_lease(self, fence: int, *, held: bool) -> None:
        """The newest fencing number, and whether it is held; if not, all up to it are over."""

    def on_stop(self, message_id: str, by: str) -> None:
        """Stop the robot; the answer names `message_id`."""

    def on_release(self, message_id: str, by: str) -> None:
        """Let a stopped robot be driven again; the answer names `message_id`."""

    def on_session_lost(self) -> None:
        """The connection that carried the session has ended."""


def message_handlers(handler: DriveMessageHandler) -> Mapping[str, Callable[[JsonObject], None]]:
    """Return what reads each kind of line; they raise FieldError."""

    def on_lease(message: JsonObject) -> None:
        fence = get_int(message, "fence", 0, MAX_FENCE)
        handler.on_lease(fence, held=get_flag(message, "held", default=False))

    def on_stop(message: JsonObject) -> None:
        message_id = get_text(message, "id", default="")
        handler.on_stop(message_id, get_text(message, "by", default=SOMEBODY))

    def on_release(message: JsonObject) -> None:
        message_id = get_match(message, "id", MESSAGE_ID, "a short id")
        handler.on_release(message_id, get_text(message, "by", default=SOMEBODY))

    return {"lease": on_lease, "stop": on_stop, "release": on_release}
