"""Compares transcripts with the files beside the tests."""

from __future__ import annotations

from dataclasses import replace

import pytest
from relay_server import FAST
from robotether_server.relay.control import stops
from robotether_server.relay.options import Timing
from robotether_server.relay.robots import lease, port_checks, robot_dialer
from syrupy.assertion import SnapshotAssertion
from transcripts import TranscriptFile

LONG_S = 60.0


@pytest.fixture
def recorded(snapshot: SnapshotAssertion) -> SnapshotAssertion:
    """What was recorded of this test; `--snapshot-update` records it anew."""
    return snapshot.use_extension(TranscriptFile)


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> Timing:
    """Times of a relay that calls nobody silent, slow or late because the machine is busy."""
    for module, name in (
        (stops, "CONFIRMED_WITHIN_S"),
        (stops, "RELEASED_WITHIN_S"),
        (lease, "PASSES_AFTER_S"),
        (lease, "RESERVED_FOR_S"),
        (port_checks, "CONNECT_WITHIN_S"),
        (robot_dialer, "MIN_CONNECT_TIMEOUT_S"),
        (robot_dialer, "MAX_CONNECT_TIMEOUT_S"),
    ):
        monkeypatch.setattr(module, name, LONG_S)
    return replace(FAST, timeout_s=LONG_S)
