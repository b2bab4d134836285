"""Signs with Ed25519, and verifies with any key of a robot, as `ssh-keygen -Y` does (OpenSSH's PROTOCOL.sshsig).

Used for joins, new keys and the heads of the audit log's chains. Pure.
"""

import base64
import binascii
import hashlib
import struct
import textwrap

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ec import ECDSA, EllipticCurvePublicKey
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.padding import PKCS1v15
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPublicKey
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature
from cryptography.hazmat.primitives.hashes import SHA256, SHA384, SHA512
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    PublicFormat,
    load_ssh_public_key,
)

from robotether_server.identity import fingerprint_of

MAGIC = b"SSHSIG"
KEY_TYPE = b"ssh-ed25519"
KEY_BYTES = 32
# Kinds of signatures but Ed25519's, with what each hashes (RFC 5656, RFC 8332).
CURVE_HASHES = {
    b"ecdsa-sha2-nistp256": SHA256(),
    b"ecdsa-sha2-nistp384": SHA384(),
    b"ecdsa-sha2-nistp521": SHA512(),
}
RSA_HASHES = {b"rsa-sha2-256": SHA256(), b"rsa-sha2-512": SHA512()}
BEGIN, END = (f"-----{edge} SSH SIGNATURE-----" for edge in ("BEGIN", "END"))


class SigningKey:
    """An Ed25519 key that is derived from a secret, for one purpose."""

    def __init__(self, secret: str, purpose: str) -> None:
        """Derive the key; `purpose` tells it from other keys of the same secret."""
        seed = HKDF(SHA256(), KEY_BYTES, salt=None, info=purpose.encode()).derive(secret.encode())
        self._private = Ed25519PrivateKey.from_private_bytes(seed)
        public = self._private.public_key().public_bytes(Encoding.OpenSSH, PublicFormat.OpenSSH)
        # Type and base64, as in a file of OpenSSH.
        self.public_key = public.decode()

    def sign(self, namespace: str, message: str) -> str:
        """Return the armoured signature over a message."""
        header = _fields(namespace.encode(), b"", b"sha512")
        signature = self._private.sign(_signed_bytes(header, message, "sha512"))
        blob = MAGIC + struct.pack(">I", 1) + _fields(_blob(self.public_key)) + header
        blob += _fields(_fields(KEY_TYPE, signature))
        lines = textwrap.wrap(base64.b64encode(blob).decode(), 70)
        return "\n".join((BEGIN, *lines, END, ""))


def fingerprint(public_key: str) -> str:
    """Return a key's fingerprint, as `ssh-keygen -l` prints it; raise ValueError when it is no key."""
    return fingerprint_of(_blob(public_key))


def key_of(signature: str) -> str | None:
    """Return the public key that a signature claims to be of, None: it is no signature."""
    try:
        blob = _parse(signature)[0]
        return f"{_split_fields(blob)[0].decode('ascii')} {base64.b64encode(blob).decode()}"
    except (ValueError, IndexError, struct.error):
        return None


def is_signed(public_key: str, namespace: str, message: str, signature: str) -> bool:
    """Return whether the armoured signature over the message is that key's, for that namespace."""
    try:
        key, header, hash_name, outer = _parse(signature)
        if key != _blob(public_key) or not header.startswith(_fields(namespace.encode(), b"")):
            return False
        _verify(public_key, outer, _signed_bytes(header, message, hash_name))
    # NotImplementedError: a key whose point is none, as somebody may have written into the database.
    except (InvalidSignature, UnsupportedAlgorithm, NotImplementedError, ValueError, struct.error):
        return False
    return True


def _verify(public_key: str, outer: bytes, data: bytes) -> None:
    """Raise InvalidSignature, UnsupportedAlgorithm, ValueError or struct.error when the key has not signed the data."""
    kind, raw = _split_fields(outer)
    key, key_type = (
        load_ssh_public_key(public_key.encode()),
        public_key.split(maxsplit=1)[0].encode(),
    )
    if isinstance(key, Ed25519PublicKey) and kind == key_type == KEY_TYPE:
        key.verify(raw, data)
    elif isinstance(key, EllipticCurvePublicKey) and kind == key_type and kind in CURVE_HASHES:
        r, s = (int.from_bytes(number) for number in _split_fields(raw))
        key.verify(encode_dss_signature(r, s), data, ECDSA(CURVE_HASHES[kind]))
    elif isinstance(key, RSAPublicKey) and kind in RSA_HASHES:
        key.verify(raw, data, PKCS1v15(), RSA_HASHES[kind])
    else:
        raise InvalidSignature


def _parse(signature: str) -> tuple[bytes, bytes, str, bytes]:
    """Return key, signed header, name of the hash and the signature with its kind; raise ValueError or struct.error."""
    lines = signature.strip().splitlines()
    if len(lines) < 3 or (lines[0], lines[-1]) != (BEGIN, END):  # noqa: PLR2004 - two edges and one line
        raise ValueError("no signature of SSH")
    blob = base64.b64decode("".join(lines[1:-1]), validate=True)
    if not blob.startswith(MAGIC + struct.pack(">I", 1)):
        raise ValueError("no signature of SSH")
    key, namespace, reserved, hash_name, outer = _split_fields(blob[len(MAGIC) + 4 :])
    if hash_name not in (b"sha256", b"sha512"):
        raise ValueError("of another kind")
    return key, _fields(namespace, reserved, hash_name), hash_name.decode(), outer


def _signed_bytes(header: bytes, message: str, hash_name: str) -> bytes:
    return MAGIC + header + _fields(hashlib.new(hash_name, message.encode()).digest())


def _blob(public_key: str) -> bytes:
    try:
        return base64.b64decode(public_key.split()[1], validate=True)
    except (IndexError, binascii.Error) as error:
        raise ValueError("no public key") from error


def _fields(*fields: bytes) -> bytes:
    return b"".join(struct.pack(">I", len(field)) + field for field in fields)


def _split_fields(blob: bytes) -> list[bytes]:
    """Split SSH's wire format (RFC 4251): fields of a four-byte length and that many bytes.

    Raises ValueError or struct.error where it is cut short.
    """
    fields = []
    at = 0
    while at < len(blob):
        (length,) = struct.unpack_from(">I", blob, at)
        field = blob[at + 4 : at + 4 + length]
        if len(field) != length:
            raise ValueError("cut short")
        fields.append(field)
        at += 4 + length
    return fields
