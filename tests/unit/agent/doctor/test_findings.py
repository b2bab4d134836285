"""How a finding reads."""

from __future__ import annotations

from robotether_agent.doctor.findings import fail, ok, skipped


def test_one_line_a_step_and_the_advice_below_a_fail():
    """A person reads down the first column and finds what to do beside the first FAIL."""
    assert str(ok("clock", "it is right")) == "ok       clock        it is right"
    assert str(skipped("answer", "no connection")) == "skipped  answer       no connection"
    assert str(fail("disk", "it is full", "make room")).splitlines() == [
        "FAIL     disk         it is full",
        "                      what to do: make room",
    ]
