"""An agent installed as on a robot: versions, `current`, a unit file, and a double of systemctl that runs it."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

from fake_cloud import FakeCloud, agent_environ
from openssh_server import is_alive, kill, wait_until
from robotether_agent.status import Status, read_status
from robotether_agent.upgrade import Layout

SYSTEMCTL = Path(__file__).with_name("fake_systemctl")


class InstalledAgent:
    """Everything lives in `place`; `environ` is what the service and the commands run with."""

    def __init__(self, place: Path, cloud: FakeCloud) -> None:
        self.layout = Layout(place / "opt", place / "robotether-agent.service")
        self.run_dir = place / "run"
        self._systemd = place / "systemd"
        (place / "opt/versions").mkdir(parents=True)
        (place / "bin").mkdir()
        self._systemd.mkdir()
        shutil.copy(SYSTEMCTL, place / "bin/systemctl")
        (self._systemd / "status").write_text(str(self.run_dir / "status.json"))
        (self._systemd / "command").write_text(
            f"{self.layout.base}/current/bin/robotether-agent run"
        )
        self.environ = {
            **agent_environ(cloud, place),
            "PATH": f"{place / 'bin'}:{os.environ['PATH']}",
            "PYTHONPATH": ":".join(sys.path),
            "FAKE_SYSTEMD": str(self._systemd),
        }

    def add(self, name: str, unit: str = "a unit file\n") -> Path:
        version = self.layout.base / "versions" / name
        (version / "bin").mkdir(parents=True)
        (version / "share/robotether-agent").mkdir(parents=True)
        script = version / "bin/robotether-agent"
        script.write_text(f"#!/bin/sh\nexec {sys.executable} -m robotether_agent $@\n")
        script.chmod(0o755)
        (version / "share/robotether-agent/robotether-agent.service").write_text(unit)
        return version

    @property
    def calls(self) -> list[str]:
        """What systemctl was told, questions left out."""
        path = self._systemd / "log"
        lines = path.read_text().splitlines() if path.exists() else []
        return [line for line in lines if not line.startswith("is-active")]

    def status(self) -> Status | None:
        return read_status(self.run_dir)

    def stop(self) -> None:
        path = self._systemd / "pid"
        if path.exists():
            pid = int(path.read_text())
            kill(pid)
            wait_until(lambda: not is_alive(pid), lambda: "the agent has ended")
