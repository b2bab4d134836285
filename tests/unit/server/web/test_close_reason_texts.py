"""Why drives and sessions ended, in words."""

from __future__ import annotations

import inspect
import re
from typing import get_args

from robotether_server.relay.http import close_reasons
from robotether_server.relay.robots.sessions import ByeCode
from robotether_server.web.close_reason_texts import DRIVES, SESSIONS, drive_end, session_end

# What a relay writes of drives and sessions that the one before it left open.
BY_THE_NEXT_RELAY = {"relay_restarted"}
# Ends who watches alone: a drive has no pictures on its connection.
OF_VIDEO = {"video_down"}


def test_every_ending_of_a_drive_has_words() -> None:
    """Those of the relay's own list, and no other."""
    written = set(re.findall(r'CloseReason\(\s*\d+, "([a-z_]+)"', inspect.getsource(close_reasons)))
    assert len(written) > 15
    assert set(DRIVES) == written - OF_VIDEO | BY_THE_NEXT_RELAY
    assert written >= OF_VIDEO


def test_every_ending_of_a_session_has_words() -> None:
    """Those that the agent reads in `bye`, and no other."""
    assert set(SESSIONS) == set(get_args(ByeCode)) | BY_THE_NEXT_RELAY


def test_unknown_code_is_shown_as_it_is() -> None:
    """A page tells what it can."""
    assert (drive_end("lease_lost"), drive_end("eaten")) == ("a change of driver", "eaten")
    assert (session_end("timeout"), session_end("eaten")) == (SESSIONS["timeout"], "eaten")
