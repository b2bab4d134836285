"""Which robots an ssh_config has."""

from __future__ import annotations

from pathlib import Path

import pytest
from robotether_server.cli.fleet import inventory
from robotether_server.cli.fleet.problems import ConfigUnusable, RobotsUnknown

ROBOTS = """
Host sim1
    HostName 127.0.0.1
    HostKeyAlias robotether-sim1
Host sim2
    HostKeyAlias=robotether-sim2
"""
OTHERS = """
# Host commented
Host bank
    HostKeyAlias my-bank
Host *.lab !gate
    HostKeyAlias robotether-x
Match host sim3
    HostKeyAlias robotether-sim3
Host "an unfinished quote
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "config"
    path.write_text(ROBOTS + OTHERS)
    return path


def test_only_what_the_server_printed_is_a_robot(config: Path) -> None:
    """A person's other hosts, patterns and broken lines are none."""
    assert inventory.robots_in(config) == {"sim1", "sim2"}


@pytest.mark.parametrize(
    ("patterns", "names"),
    [(["*"], ["sim1", "sim2"]), (["sim2", "sim[12]"], ["sim1", "sim2"]), (["*2"], ["sim2"])],
)
def test_patterns_choose_robots_once(config: Path, patterns: list[str], names: list[str]) -> None:
    """In the order of their names."""
    assert inventory.choose(config, patterns) == names


def test_pattern_without_a_robot_is_a_mistake(config: Path) -> None:
    """Even beside another that has some; the sentence lists what there is."""
    with pytest.raises(
        RobotsUnknown, match=r"for bank: .* has sim1, sim2; .* robotether ssh-config"
    ):
        inventory.choose(config, ["sim1", "bank"])


def test_included_files_are_read(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By absolute name, or below ~/.ssh, with wildcards."""
    monkeypatch.setenv("HOME", str(tmp_path))
    home = tmp_path / ".ssh"
    home.mkdir()
    (home / "fleet.conf").write_text(ROBOTS.replace("sim2", "turtle"))
    (home / "config").write_text(f"Include fleet.* {config}\n")
    assert inventory.choose(None, ["*"]) == ["sim1", "sim2", "turtle"]


def test_file_that_includes_itself_is_refused(tmp_path: Path) -> None:
    """As OpenSSH does, and not for ever."""
    path = tmp_path / "config"
    path.write_text(f"Include {path}\n")
    with pytest.raises(ConfigUnusable, match="over 16 deep"):
        inventory.robots_in(path)


def test_missing_file_is_told_with_the_way_to_get_it(tmp_path: Path) -> None:
    """In one sentence."""
    with pytest.raises(ConfigUnusable, match=r"cannot read .*missing.* robotether ssh-config"):
        inventory.choose(tmp_path / "missing", ["*"])
