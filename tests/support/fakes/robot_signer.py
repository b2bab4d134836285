"""A robot's key in memory that signs as its agent does with ssh-keygen, and the join that it asks for."""

from __future__ import annotations

import secrets

from robotether_common.join import JOIN_NAMESPACE, join_message
from robotether_server import identity
from robotether_server.identity import PublicKey, normalise_mac
from robotether_server.signatures import SigningKey


class RobotSigner(SigningKey):
    """An ed25519 key; of a number always the same one."""

    def __init__(self, number: int | None = None) -> None:
        super().__init__(secrets.token_hex() if number is None else str(number), "tests")
        self.line = f"{self.public_key} robot"

    @property
    def key(self) -> PublicKey:
        return identity.parse_robots_key(self.line)

    def proof(self, mac: str, token: str | None = None) -> str:
        message = join_message(token, normalise_mac(mac), self.key.line)
        return self.sign(JOIN_NAMESPACE, message)

    def join(self, mac: str, token: str | None = None, **fields: object) -> dict[str, object]:
        return {
            "mac": mac,
            "public_key": self.line,
            "signature": self.proof(mac, token),
            "hostname": "turtle",
            "agent_version": "0.1.0",
            **({} if token is None else {"token": token}),
            **fields,
        }
