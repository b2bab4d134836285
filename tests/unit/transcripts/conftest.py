"""Compares transcripts with the files beside the tests."""

from __future__ import annotations

import pytest
from syrupy.assertion import SnapshotAssertion
from transcripts import TranscriptFile


@pytest.fixture
def recorded(snapshot: SnapshotAssertion) -> SnapshotAssertion:
    """What was recorded of this test; `--snapshot-update` records it anew."""
    return snapshot.use_extension(TranscriptFile)
