"""Robots that the server has admitted: their rows, keys and pinned host keys, ready for any agent to start with.

Used by world.py, which makes the rows. The join is the agent's own code against the server itself.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from robotether_agent import settings as agent_settings
from robotether_agent.enrolment.enroller import Enroller

# The server lets one robot in at a time; so many keys are made meanwhile.
AT_ONCE = 4


@dataclass(frozen=True)
class Enrolled:
    """One robot as the server and its own disk know it."""

    name: str
    # In its World; gives it addresses of its own beside others in one network.
    number: int
    mac: str
    # HOST:PORT of the server's https, the same from every uplink: a robot may start behind any of them.
    server: str
    tls_fingerprint: str
    # With `state` in it; what runs writes its logs here.
    folder: Path

    @property
    def state_dir(self) -> Path:
        """Where the agent keeps its key, its enrolment and the host keys."""
        return self.folder / "state"

    @property
    def settings(self) -> dict[str, str]:
        """The agent's settings that make it this robot, as agent.toml names them."""
        return {
            "server": self.server,
            "tls_fingerprint": self.tls_fingerprint,
            "mac": self.mac,
            "allow_local_mac": "true",
            "state_dir": str(self.state_dir),
        }


def environment(settings: Mapping[str, object]) -> dict[str, str]:
    """An agent's settings as its environment gives them."""
    return {f"ROBOTETHER_{name.upper()}": str(value) for name, value in settings.items()}


def local_mac(pid: int, number: int) -> str:
    """A locally administered MAC of robot `number` of this process; both count to 16 million and 65,536."""
    digits = f"02{pid % (1 << 24):06x}{number % (1 << 16):04x}"
    return ":".join(digits[at : at + 2] for at in range(0, len(digits), 2))


def join_all(robots: Sequence[Enrolled], token: str) -> None:
    """Let each make its key and join with the token, as an agent does at its first start."""
    asyncio.run(_join_all(robots, token))


async def _join_all(robots: Sequence[Enrolled], token: str) -> None:
    slots = asyncio.Semaphore(AT_ONCE)

    async def join(robot: Enrolled) -> None:
        robot.folder.mkdir(mode=0o700)
        given = environment({**robot.settings, "token": token})
        async with slots:
            await Enroller(agent_settings.load(None, given)).join()

    await asyncio.gather(*map(join, robots))
