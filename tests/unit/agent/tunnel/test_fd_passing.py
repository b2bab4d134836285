"""The helper's start stands before each tunnel: it must be quick, and say nothing on the connection."""

from __future__ import annotations

import shlex

from robotether_agent.tunnel import openssh
from robotether_agent.tunnel.openssh import _proxy_options


def helper() -> list[str]:
    return shlex.split(_proxy_options()[0].removeprefix("ProxyCommand=").replace("%%", "%"))


def test_a_strange_place_is_quoted(monkeypatch):
    """Python may live where a shell, or ssh, would read something else."""
    monkeypatch.setattr(openssh.sys, "executable", "/o p't/%h/python")
    assert helper()[0] == "/o p't/%h/python"
    assert "%%h" in _proxy_options()[0]
