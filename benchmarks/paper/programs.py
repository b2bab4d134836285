"""Programs that a step starts, ours and others', each with all that it starts; ended by their ids, never by a name."""

from __future__ import annotations

import asyncio
import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from namespaces import Namespace
from openssh_server import descendants, is_alive, kill, wait_until

# An agent publishes zeros for half a second when its robot was moving, and closes its tunnels.
ENDS_WITHIN_S = 5.0
LOG_LINES = 30
# In place of a line of a program that is no more.
GONE = object()


def our_environment() -> dict[str, str]:
    """This process's environment and modules, with nothing that the agent or the simulator would take for settings."""
    stored = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("ROBOTETHER_", "SIM_"))
    }
    return {**stored, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))}


class Program:
    """A module of ours, run in a namespace; its words go to the end of the file `log`."""

    def __init__(
        self, namespace: Namespace, words: Sequence[str], log: Path, environ: Mapping[str, str]
    ) -> None:
        self._name = f"{' '.join(words):.80}"
        self._log = log
        with log.open("ab") as out:
            self._process = subprocess.Popen(
                namespace.command(sys.executable, "-m", *words),
                env={**our_environment(), **environ},
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                # A Ctrl-C is for the experiment, which then ends its programs in order.
                start_new_session=True,
            )
        self.pid = self._process.pid

    def check(self) -> None:
        if (code := self._process.poll()) is not None:
            raise RuntimeError(f"{self._name} ended with {code}; its last words:\n{self.tail()}")

    def tail(self) -> str:
        return "\n".join(self._log.read_text(errors="replace").splitlines()[-LOG_LINES:])

    def end(self) -> None:
        """End it in order, and kill what is left of it and of what it started."""
        if self._process.poll() is not None:
            return
        started = descendants(self.pid)
        self._process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(ENDS_WITHIN_S)
        self._kill(started)

    def kill(self) -> None:
        self._kill(descendants(self.pid))

    def _kill(self, started: Sequence[int]) -> None:
        self._process.kill()
        self._process.wait()
        for pid in started:
            kill(pid)
        wait_until(
            lambda: not any(map(is_alive, started)), lambda: f"what {self._name} started ended"
        )


class LineProgram:
    """A module of ours that takes and writes lines of JSON; it must end when its input does.

    `before` are words before the command, such as those that run it in a namespace.
    """

    def __init__(self, module: str, log: Path, before: Sequence[str] = ()) -> None:
        self._log = log
        with log.open("wb") as errors:
            self._process = subprocess.Popen(
                [*before, sys.executable, "-m", module],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                bufsize=1,
                env=our_environment(),
                start_new_session=True,
            )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._input, self._output = self._process.stdin, self._process.stdout
        self.pid = self._process.pid
        # Its lines that are waited for, and GONE when it has ended.
        self._lines: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._reading = threading.Thread(target=self._read, daemon=True)
        self._reading.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end(ENDS_WITHIN_S)

    def send(self, value: object) -> None:
        self._input.write(json.dumps(value) + "\n")
        self._input.flush()

    def handle(self, message: Any) -> bool:
        """Whether a line was for nobody who waits; called in a thread of its own."""
        del message
        return False

    def receive(self, what: str, seconds: float) -> Any:
        """Its next line; RuntimeError with its last words when there is none in time, and all of them as a note."""
        line, why = GONE, f"did not say in {seconds:.0f} s"
        with suppress(queue.Empty):
            line, why = self._lines.get(timeout=seconds), "ended"
        if line is GONE:
            words = self.tail()
            last = words.rstrip().rpartition("\n")[2]
            error = RuntimeError(f"a process of ours {why}: {what}; {last or 'it wrote no error'}")
            error.add_note(words)
            raise error
        return line

    def tail(self) -> str:
        return self._log.read_text(errors="replace")[-2000:]

    def end_input(self) -> None:
        with suppress(BrokenPipeError):
            self._input.close()

    def end(self, within_s: float) -> None:
        """Let it end in order, as its input ends; what does not is killed."""
        self.end_input()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(within_s)
        self._process.kill()
        self._process.wait()
        # What it started may hold its output still.
        self._reading.join(2)
        self._output.close()

    def _read(self) -> None:
        for line in self._output:
            message = json.loads(line)
            if not self.handle(message):
                self._lines.put(message)
        self._lines.put(GONE)


async def read_line() -> Any:
    return json.loads(await asyncio.to_thread(sys.stdin.readline) or "null")


def write_line(value: object) -> None:
    sys.stdout.write(json.dumps(value) + "\n")
    sys.stdout.flush()
