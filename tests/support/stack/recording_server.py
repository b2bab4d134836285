"""A server for a robot, with the real relay behind a real sshd, that keeps each line that passes."""

from __future__ import annotations

import ast
import asyncio
import json
import os
import re
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from fake_cloud import FakeCloud, Link
from fake_robot import FINGERPRINT, HOST
from relay_server import SESSION_KEY, RelayServer

ROOT = Path(__file__).resolve().parents[3]
Said = dict[str, Any]


def preface(kind: str, robot_id: int, ports: tuple[int, ...]) -> bytes:
    source = (ROOT / "images/sshd/session.c").read_text()
    found = re.search(r"snprintf\(line, sizeof line,\s*(.*?),\s*wanted_kind", source, re.DOTALL)
    assert found
    layout = ast.literal_eval(f"({found[1]})").replace("%lu", "%d")
    source_address = ("198.51.100.7", 51234)
    members = (kind, robot_id, FINGERPRINT, ",".join(map(str, ports)), *source_address, SESSION_KEY)
    return (layout % members).encode()


class RecordingServer(FakeCloud):
    def __init__(self, relay: RelayServer, robot_id: int) -> None:
        super().__init__()
        self.said: list[tuple[str, str, Said]] = []
        self._relay_port = relay.relay.session_port
        self._robot_id = robot_id

    async def _serve_link(self, link: Link, reader: asyncio.StreamReader) -> None:
        relay_in, relay_out = await asyncio.open_connection(HOST, self._relay_port)
        first = preface(link.kind, self._robot_id, self.ports)
        self.said.append((link.kind, "session command", json.loads(first)))
        relay_out.write(first)
        up = asyncio.ensure_future(self._pass(link.kind, "agent", reader, relay_out))
        try:
            await self._pass(link.kind, "relay", relay_in, link._writer)
        finally:
            up.cancel()
            await asyncio.gather(up, return_exceptions=True)
            relay_out.close()

    async def _pass(
        self, kind: str, who: str, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        while line := await reader.readline():
            self.said.append((kind, who, json.loads(line)))
            writer.write(line)


@asynccontextmanager
async def running_agent(environ: dict[str, str]) -> AsyncIterator[int]:
    """Run the agent as its boot service does; its process' number."""
    environ = {
        "PATH": os.environ["PATH"],
        "PYTHONPATH": f"{ROOT / 'agent'}:{ROOT / 'common'}",
        **environ,
    }
    agent = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "robotether_agent", "run", env=environ
    )
    try:
        yield agent.pid
    finally:
        agent.terminate()
        await agent.wait()
