"""Other people's programs in namespaces: started, looked after, ended by their own ids, and what they compute.

Used by the ways that are compared (peer_way.py). Never ends a process by its name.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from namespaces import Namespace
from openssh_server import descendants, is_alive, kill, wait_until
from processes import ticks

ENDS_WITHIN_S = 5.0
LOG_LINES = 30
TICK_S = 1 / os.sysconf("SC_CLK_TCK")


class Program:
    """One program in a namespace, with all that it starts; its words go to the end of the file `log`."""

    def __init__(
        self,
        namespace: Namespace,
        words: Sequence[str],
        log: Path,
        environ: Mapping[str, str] | None = None,
    ) -> None:
        self._name = words[0]
        self._log = log
        with log.open("ab") as out:
            self._process = subprocess.Popen(
                namespace.command(*words),
                env={**os.environ, **(environ or {})},
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                # A Ctrl-C is for the experiment, which then ends its programs in order.
                start_new_session=True,
            )

    def pids(self) -> list[int]:
        """It, and all below it; empty when it has ended."""
        own = self._process.pid
        return [own, *descendants(own)] if self._process.poll() is None else []

    def check(self) -> None:
        """Raise with its last words if it has ended."""
        if (code := self._process.poll()) is not None:
            raise RuntimeError(f"{self._name} ended with {code}; its last words:\n{self.tail()}")

    def tail(self) -> str:
        """What it said last."""
        return "\n".join(self._log.read_text(errors="replace").splitlines()[-LOG_LINES:])

    def end(self) -> None:
        """End it in order, and at once what it has left."""
        below = descendants(self._process.pid)
        self._process.terminate()
        try:
            self._process.wait(ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for pid in below:
            kill(pid)
        wait_until(lambda: not any(map(is_alive, below)), lambda: f"{self._name}'s children ended")


def cpu_s(pids: Iterable[int]) -> dict[int, float]:
    """Seconds that each process has computed so far, user and system, all threads; those that ended are left out."""
    taken = {}
    for pid in pids:
        with suppress(OSError):
            taken[pid] = ticks(pid) * TICK_S
    return taken


def cpu_between(before: Mapping[int, float], after: Mapping[int, float]) -> float:
    """Seconds computed between two looks; a process that began meanwhile counts whole."""
    return sum(seconds - before.get(pid, 0.0) for pid, seconds in after.items())
