"""The robot's two ports forwarded by one `ssh -R`, kept by autossh, as the paper has it; OpenSSH at both ends.

Settings are those of autossh's manual and the usual guides: no monitoring port, keep-alives of OpenSSH's own at both
ends, and an ssh that ends when it does not get its port. The keep-alives decide how soon a dead tunnel is noticed.
"""

from __future__ import annotations

import subprocess
from contextlib import ExitStack

from openssh_server import OpenSshServer

from paper.peer_plan import SSH
from paper.peer_transport import ROS_PORT, VIDEO_PORT, PlainTransport

# Many guides say 30 s three times, which would take three times as long to notice.
ALIVE_S, ALIVE_TIMES = 10, 3


class AutoSsh(PlainTransport):
    """A bare `ssh -R`."""

    key, packages = SSH, ("autossh",)
    _sshd: OpenSshServer

    def prepare(self, made: ExitStack) -> None:
        self.simulator(made)
        alive = (f"ClientAliveInterval {ALIVE_S}", f"ClientAliveCountMax {ALIVE_TIMES}")
        # No session is opened, so that what is behind the session command is never asked.
        self._sshd = OpenSshServer(relay_port=0, address=self.server.address, more=alive)
        made.callback(self._sshd.close)
        key = self.folder / "key"
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(key)], check=True)
        public = key.with_suffix(".pub").read_text().strip()
        self._sshd.authorize(public, (ROS_PORT, VIDEO_PORT))
        name = f"[{self._sshd.address}]:{self._sshd.port}"
        (self.folder / "known_hosts").write_text(f"{name} {self._sshd.host_keys[0]}\n")
        with self.server.entered():
            self._sshd.start()

    def connect(self) -> None:
        options = (
            "BatchMode=yes",
            f"UserKnownHostsFile={self.folder}/known_hosts",
            f"ServerAliveInterval={ALIVE_S}",
            f"ServerAliveCountMax={ALIVE_TIMES}",
            "ExitOnForwardFailure=yes",
        )
        words = ["autossh", "-M", "0", "-F", "none", "-N", "-i", str(self.folder / "key")]
        words += [word for option in options for word in ("-o", option)]
        for port in (ROS_PORT, VIDEO_PORT):
            words += ["-R", f"*:{port}:127.0.0.1:{port}"]
        words += ["-p", str(self._sshd.port), f"{self._sshd.user}@{self._sshd.address}"]
        # As in the guides' unit files: it goes on also when its first connection fails.
        environ = ("env", "AUTOSSH_GATETIME=0")
        self._client = [self.start(self.inside, "autossh", *environ, *words)]

    def robot_address(self) -> str:
        return self.server.address

    def server_pids(self) -> list[int]:
        return self._sshd.pids()
