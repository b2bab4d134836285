"""What answers at a server's SSH port, without the SSH behind it: for tests of how the agent gets there.

speaks     says its name at once, as sshd does
late       says its name when the test lets it (`may_speak`), as an sshd does that has too much to do
shy        says its name when spoken to, as nginx's port 443 makes it look
silent     accepts and says nothing, as a captive portal may
babbles    says what is not SSH
closes     ends every connection at once, as nginx does whose sshd is away
full       lets no log-in begin, in the words of OpenSSH 10 at its MaxStartups
full_before_10  the same, in the words of those before it
"""

from __future__ import annotations

import asyncio
from typing import Literal

from tcp_service import TcpService

Mode = Literal["speaks", "late", "shy", "silent", "babbles", "closes", "full", "full_before_10"]

BANNER = b"SSH-2.0-door\r\n"
REFUSALS = {
    "full": b"Not allowed at this time\r\n",
    "full_before_10": b"Exceeded MaxStartups\r\n",
}


class SshPort(TcpService):
    """One port; `connections` counts them, `heard` is what they said."""

    def __init__(self, mode: Mode = "speaks") -> None:
        super().__init__()
        self.mode = mode
        self.connections = 0
        self.heard = b""
        self.may_speak = asyncio.Event()

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        if self.mode == "closes":
            return
        if self.mode == "late":
            await self.may_speak.wait()
        if self.mode == "shy":
            self._hear(await reader.readline())
        if self.mode in REFUSALS:
            writer.write(REFUSALS[self.mode])
        elif self.mode == "babbles":
            writer.write(b"HTTP/1.1 302 Log in first\r\n\r\n")
        elif self.mode != "silent":
            writer.write(BANNER)
        self._hear(await reader.read())

    def _hear(self, words: bytes) -> None:
        self.heard += words
