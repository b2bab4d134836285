"""A robot's key in memory that signs as its agent does with ssh-keygen, and the join that it asks for."""

from __future__ import annotations

import base64
import hashlib
import struct
import textwrap

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from robotether_common.join import JOIN_NAMESPACE, join_message
from robotether_server import identity
from robotether_server.identity import PublicKey, normalise_mac


class RobotSigner:
    """An ed25519 key; of a number always the same one."""

    def __init__(self, number: int | None = None) -> None:
        self._private = (
            Ed25519PrivateKey.generate()
            if number is None
            else Ed25519PrivateKey.from_private_bytes(number.to_bytes(32, "big"))
        )
        public = self._private.public_key().public_bytes(Encoding.OpenSSH, PublicFormat.OpenSSH)
        self.line = f"{public.decode()} robot"

    @property
    def key(self) -> PublicKey:
        return identity.parse_robots_key(self.line)

    def sign(self, namespace: str, message: str) -> str:
        """The armoured signature over a message (OpenSSH's PROTOCOL.sshsig)."""
        of_what = _fields(namespace.encode(), b"", b"sha512")
        digest = hashlib.sha512(message.encode()).digest()
        signature = self._private.sign(b"SSHSIG" + of_what + _fields(digest))
        public = base64.b64decode(self.line.split()[1])
        blob = b"SSHSIG" + struct.pack(">I", 1) + _fields(public) + of_what
        blob += _fields(_fields(b"ssh-ed25519", signature))
        lines = textwrap.wrap(base64.b64encode(blob).decode(), 70)
        edges = (f"-----{edge} SSH SIGNATURE-----" for edge in ("BEGIN", "END"))
        return "\n".join((next(edges), *lines, next(edges), ""))

    def proof(self, mac: str, token: str | None = None) -> str:
        message = join_message(token, normalise_mac(mac), self.key.line)
        return self.sign(JOIN_NAMESPACE, message)

    def join(self, mac: str, token: str | None = None, **fields: object) -> dict[str, object]:
        """The body of a join with this key and its proof."""
        return {
            "mac": mac,
            "public_key": self.line,
            "signature": self.proof(mac, token),
            "hostname": "turtle",
            "agent_version": "0.1.0",
            **({} if token is None else {"token": token}),
            **fields,
        }


def _fields(*fields: bytes) -> bytes:
    return b"".join(struct.pack(">I", len(field)) + field for field in fields)
