"""What of a configuration makes the agent do more than keep its two tunnels."""

from __future__ import annotations

from robotether_agent.session import Config
from robotether_agent.wishes import Wishes


def config(*, shell_port: int | None = None, rotate_key: bool = False) -> Config:
    return Config("sim1", 20000, 20001, 1.0, 5.0, shell_port, rotate_key)


def test_a_shell_is_wanted_while_there_is_a_port():
    """The wish comes and goes with the port."""
    wishes = Wishes(allows_shell=True)
    assert not wishes.shell.is_set()
    wishes.take(config(shell_port=24000))
    assert wishes.shell.is_set()
    wishes.take(config())
    assert not wishes.shell.is_set()


def test_a_robot_that_allows_no_shell_gets_none():
    """Its own settings have the last word, whatever an admin wishes."""
    wishes = Wishes(allows_shell=False)
    wishes.take(config(shell_port=24000))
    assert not wishes.shell.is_set()


def test_one_wish_for_a_key_is_one_key():
    """A configuration that repeats a wish which was fulfilled meanwhile is none; a wish can be withdrawn."""
    wishes = Wishes(allows_shell=True)
    wishes.take(config(rotate_key=True))
    assert wishes.new_key.is_set()
    wishes.new_key.clear()
    wishes.take(config(rotate_key=True))
    assert not wishes.new_key.is_set()
    wishes.take(config())
    wishes.take(config(rotate_key=True))
    assert wishes.new_key.is_set()
    wishes.take(config())
    assert not wishes.new_key.is_set()
