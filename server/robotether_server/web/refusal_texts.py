"""What was refused on a drive, in words for a table's cell. Pure.

A kind that is not here is shown as it is, as all are in the API and in the files for programs.
"""

from collections.abc import Mapping

# They follow on a number of messages. Kinds of the relay's policy, and those of the guard on the robot (guard_).
KINDS: Mapping[str, str] = {
    "topic": "to a topic that is not allowed",
    "service": "to a service that is not allowed",
    "operation": "of an operation that is not allowed",
    "shape": "with fields that are not allowed",
    "rate": "over the rate",
    "size": "too large",
    "subscriptions": "over the number of subscriptions",
    "json": "not readable",
    "guard_old": "too old at the robot",
    "guard_fence": "of another driver at the robot",
    "guard_stopped": "while the robot was stopped",
    "guard_shape": "not understood by the robot's guard",
    "guard_held": "while the robot could not take them",
}


def refusal(kind: str) -> str:
    """Return what is said of the messages that were refused for this."""
    return KINDS.get(kind, kind)
