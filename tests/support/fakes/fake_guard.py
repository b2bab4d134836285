"""A fork server of fake guards, for tests of the supervisor: `python fake_guard.py PLACE MODE`, with named modes.

serves         listens, ticks, answers stop, release and frame, ends when it is told to
dies           ends at once, before a word
crashes        serves, and ends with status 3 when it gets a stop, before it answers
hangs          listens, says so, and then never a word again
deaf           serves and ticks, but reads nothing
stays          serves, and does not end when it is told to
rubbish        listens, and says what is not JSON

It notes what it hears in PLACE/heard.jsonl, one JSON object a line, begun by {"type": "born"}.
MODE may be several with commas: each start takes the next one, the last one stays.
"""

from __future__ import annotations

import gc
import json
import os
import select
import socket
import sys
import time
from pathlib import Path
from typing import Any

from robotether_agent.guard.fork_server import serve

TICK_S = 0.1
STATE = {"type": "guard", "state": "ready", "stopped": False, "by": "", "moving": False}
REFUSED = {"old": 0, "fence": 0, "stopped": 0, "shape": 0, "held": 0}


def fake_guard_command(place: Path, *modes: str) -> list[str]:
    return [sys.executable, __file__, str(place), ",".join(modes)]


def heard(place: Path) -> list[dict[str, Any]]:
    file = place / "heard.jsonl"
    lines = file.read_text().splitlines() if file.exists() else []
    return [message for message in map(json.loads, lines) if message["type"] != "tick"]


def births(place: Path) -> list[dict[str, Any]]:
    return [message for message in heard(place) if message["type"] == "born"]


class FakeGuard:
    def __init__(self, place: Path, modes: list[str]) -> None:
        self._place = place
        self._mode = modes[min(len(births(place)), len(modes) - 1)]
        self._listener = socket.create_server(("127.0.0.1", 0))

    def run(self) -> int:
        port = self._listener.getsockname()[1]
        born = {"pid": os.getpid(), "parent": os.getppid(), "frozen": gc.get_freeze_count()}
        self._note({"type": "born", **born, "port": port})
        if self._mode == "dies":
            return 1
        if self._mode == "rubbish":
            os.write(1, b"\xff rubbish\n")
        self._say({"type": "ready", "port": port})
        if self._mode != "hangs":
            self._say({**STATE, "answers": None, "refused": REFUSED})
        return self._serve()

    def _serve(self) -> int:
        unread = b""
        while True:
            if self._mode == "deaf":
                time.sleep(TICK_S)
            elif select.select([0], [], [], TICK_S)[0]:
                more = os.read(0, 4096)
                if not more and self._mode != "stays":
                    return 0
                *lines, unread = (unread + more).split(b"\n")
                for line in lines:
                    status = self._hear(json.loads(line))
                    if status is not None:
                        return status
            if self._mode != "hangs":
                self._say({"type": "tick"})

    def _hear(self, message: dict[str, Any]) -> int | None:
        self._note(message)
        kind = message["type"]
        if kind == "exit" and self._mode != "stays":
            return 0
        if kind == "stop" and self._mode == "crashes":
            return 3
        if kind in {"stop", "release"}:
            latch = {"stopped": kind == "stop", "by": message["by"] if kind == "stop" else ""}
            self._say({**STATE, **latch, "answers": message["id"], "refused": REFUSED})
        if kind == "frame":
            self._say({"type": "seen", "fence": 13, "ages_ms": [140.0]})
        return None

    def _note(self, message: dict[str, Any]) -> None:
        with (self._place / "heard.jsonl").open("a") as file:
            file.write(json.dumps(message) + "\n")

    def _say(self, message: dict[str, Any]) -> None:
        os.write(1, json.dumps(message).encode() + b"\n")


if __name__ == "__main__":
    serve(
        socket.socket(fileno=0), lambda: FakeGuard(Path(sys.argv[1]), sys.argv[2].split(",")).run()
    )
