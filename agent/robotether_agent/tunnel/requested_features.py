"""What the server wants beyond rosbridge and video: a connection for shells, a new key for the robot.

Filled by the agent from each configuration, awaited by the tasks that do it.
"""

from __future__ import annotations

import asyncio

from robotether_agent.tunnel.session import SessionConfig


class RequestedFeatures:
    """One event a wish, set for as long as it is to be fulfilled."""

    def __init__(self, *, allows_shell: bool) -> None:
        self.shell = asyncio.Event()
        self.new_key = asyncio.Event()
        self._allows_shell = allows_shell
        self._key_was_requested = False

    def apply(self, config: SessionConfig) -> None:
        """Follow a configuration."""
        _set(self.shell, self._allows_shell and config.shell_port is not None)
        # A configuration may still say so for a moment after the key was changed: only a new wish counts.
        if config.rotate_key != self._key_was_requested:
            _set(self.new_key, config.rotate_key)
        self._key_was_requested = config.rotate_key


def _set(event: asyncio.Event, is_requested: object) -> None:
    if is_requested:
        event.set()
    else:
        event.clear()
