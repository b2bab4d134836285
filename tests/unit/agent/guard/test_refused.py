"""The one exception of the guard's checks."""

from robotether_agent.guard.refused import KINDS, Refused


def test_it_carries_kind_and_reason() -> None:
    """Counter and answer are made of these."""
    refused = Refused("old", "it is late")
    assert (refused.kind, refused.why, str(refused)) == ("old", "it is late", "it is late")
    assert refused.kind in KINDS
