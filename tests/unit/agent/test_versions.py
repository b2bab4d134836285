"""The folders of the versions, and the link to the one in use."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest
from robotether_agent.problems import StateUnusable, UpgradeFailed
from robotether_agent.versions import COMMAND, NEW_UNIT, Layout, Report


@pytest.fixture
def layout(tmp_path) -> Layout:
    """A folder with two versions, the first in use."""
    made = Layout(tmp_path / "opt", tmp_path / "unit")
    for name in ("1", "2"):
        for file in (COMMAND, NEW_UNIT):
            path = version(made, name) / file
            path.parent.mkdir(parents=True)
            path.write_text(f"of {name}\n")
        (version(made, name) / COMMAND).chmod(0o755)
    made.use(version(made, "1"))
    return made


def version(layout: Layout, name: str) -> Path:
    return layout.base / "versions" / name


def test_current_is_a_link_that_can_be_moved_with_its_folder(layout):
    """A link within the folder, so that a copied disk or a chroot leads to its own version."""
    assert (layout.base / "current").readlink() == Path("versions/1")
    assert layout.in_use() == version(layout, "1")
    assert (layout.base / "current" / COMMAND).read_text() == "of 1\n"


def test_a_unit_file_is_installed_when_it_differs(layout):
    assert layout.unit.read_text() == "of 1\n"
    assert layout.use(version(layout, "2"))
    assert layout.unit.read_text() == "of 2\n"
    assert not layout.use(version(layout, "2"))


def test_without_a_version_in_use_there_is_nothing_to_switch_from(tmp_path):
    """The first installation makes the link itself."""
    with pytest.raises(UpgradeFailed, match="current leads to no version"):
        Layout(tmp_path).in_use()


@pytest.mark.parametrize("name", ["versions/none", "2", "versions/2/bin"])
def test_only_a_whole_version_in_its_place_is_one(layout, name):
    """Another folder, or one without the command, is refused."""
    with pytest.raises(UpgradeFailed, match="cannot switch to"):
        layout.check(layout.base / name)
    layout.check(version(layout, "2"))


def test_a_place_that_cannot_be_changed_is_told(layout):
    """Without sudo, or on a read-only disk, the sentence says so."""
    (layout.base / ".current.new").mkdir()
    with pytest.raises(StateUnusable, match="run this with sudo"):
        layout.use(version(layout, "2"))
    assert layout.in_use() == version(layout, "1")


def test_others_are_removed(layout):
    layout.keep_only(version(layout, "2"))
    assert [path.name for path in (layout.base / "versions").iterdir()] == ["2"]


def test_the_report_is_for_programs(layout):
    report = Report("done", "1", "2", "2 is in use", 1.0, 2.0)
    layout.write(report)
    assert json.loads((layout.base / "last-switch.json").read_text()) == asdict(report)
