"""The comparison's steps: which there are, and what they are called."""

from __future__ import annotations

from pathlib import Path

import pytest
from paper import peers
from paper.peer_plan import CHANGES, LATENCY, OURS, PATIENCE, SSH, STRAIGHT, TITLES, Plan, plan_of
from paper.peers import PART
from paper.runner import checked_steps
from paper.step import Scale


def test_every_way_has_every_measure_once() -> None:
    """And a bare ssh -R one more, for which the operator waits."""
    steps = Plan().steps()
    assert len(steps) == len(set(steps)) == len(TITLES) * 3 + 1
    assert (SSH, PATIENCE) in steps


def test_a_quick_run_keeps_to_what_needs_no_package_but_autossh() -> None:
    """It is for continuous integration."""
    assert plan_of(Scale(quick=True)).steps() == [(key, LATENCY) for key in (STRAIGHT, SSH, OURS)]


def test_steps_have_names_that_the_journal_takes() -> None:
    """At both scales."""
    assert len(checked_steps(PART, Scale())) == len(Plan().steps())
    assert [step.name for step in checked_steps(PART, Scale(quick=True))] == [
        "straight-latency",
        "ssh-latency",
        "robotether-latency",
    ]


def test_what_takes_a_minute_each_is_done_less_often() -> None:
    """As many new addresses as planned, but for a bare ssh -R."""
    plan = Plan()
    assert plan.recovers_of("openvpn") == plan.recovers
    assert plan.recovers_of(SSH) == plan.ssh_recovers
    assert plan.expected_s(SSH, CHANGES) > plan.expected_s("openvpn", CHANGES)


def test_a_package_that_cannot_be_had_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its way fails with the reason, and the others can still be measured."""
    (tmp_path / "tools").mkdir()
    tool = tmp_path / "tools" / "ensure_peers"
    tool.write_text("#!/bin/sh\necho no $1 here >&2; exit 1\n")
    tool.chmod(0o755)
    monkeypatch.setattr(peers, "ROOT", tmp_path)
    with pytest.raises(RuntimeError, match="cannot install nebula: no nebula here"):
        peers.ensure(["nebula"])


def test_nothing_is_installed_for_a_way_without_programs() -> None:
    """It needs no package, so no root."""
    peers.ensure([])
