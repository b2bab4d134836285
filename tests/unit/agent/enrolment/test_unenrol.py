"""A machine that forgets who it is becomes a robot of its own at its next start."""

from __future__ import annotations

import pytest
from fake_cloud import agent_environ
from robotether_agent.enrolment.enroller import Enroller
from robotether_agent.enrolment.keys import ensure_next_key
from robotether_agent.enrolment.unenrol import FILES, enrolment_files, unenrol
from robotether_agent.files import LOCK, ensure_directory, only_one
from robotether_agent.problems import AlreadyRunning
from robotether_agent.settings import Settings, load


@pytest.fixture
async def settings(make_cloud, place) -> Settings:
    """The settings of a robot that has joined and is about to change its key."""
    made = load(None, agent_environ(await make_cloud(), place, mac="", interface="lo"))
    (place / "state").mkdir()
    (place / "state/identity.json").write_text('{"mac": "00:1b:44:11:3a:b7", "interface": "lo"}')
    await Enroller(made).enrolment()
    await ensure_next_key(made.state_dir)
    return made


def test_nothing_that_names_the_robot_stays(settings):
    """Key, next key, enrolment, pinned host keys and MAC are gone, and nothing else ever was there."""
    assert {path.name for path in settings.state_dir.iterdir()} == set(FILES)
    unenrol(settings)
    assert list(settings.state_dir.iterdir()) == []
    assert enrolment_files(settings.state_dir) == []


def test_not_while_the_agent_runs(settings):
    ensure_directory(settings.run_dir, "run_dir")
    with only_one(settings.run_dir / LOCK):
        with pytest.raises(AlreadyRunning, match="its agent runs") as error:
            unenrol(settings)
        assert "systemctl stop" in error.value.advice
    assert enrolment_files(settings.state_dir)
    unenrol(settings)
    assert not enrolment_files(settings.state_dir)
