"""What was refused, in words."""

from __future__ import annotations

from typing import get_args

from robotether_server.relay.drives.drive_log import GUARD
from robotether_server.relay.robots.session_messages import REFUSED_KINDS
from robotether_server.relay.rosbridge.message_validator import Kind
from robotether_server.web.refusal_texts import KINDS, refusal


def test_every_kind_has_words() -> None:
    """Those of the policy and those of the guard, and no other."""
    assert set(KINDS) == {*get_args(Kind), *(GUARD + kind for kind in REFUSED_KINDS)}


def test_unknown_kind_is_shown_as_it_is() -> None:
    """A page tells what it can."""
    assert (refusal("guard_old"), refusal("eaten")) == ("too old at the robot", "eaten")
