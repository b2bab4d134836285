"""Reads one OpenSSH public key line, as a robot presents it or a person in the profile; checks signatures.

Used by api, web and services. What it returns is written into sshd's answer to AuthorizedKeysCommand, so it
lets nothing through but a key type and its base64: no options, no comment, no second line.
"""

import base64
import binascii
import hashlib
import logging
import struct
import subprocess
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from robotether_server.problems import FieldInvalid

logger = logging.getLogger(__name__)

MAX_LINE_LENGTH = 2048
EXAMPLE = "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIJo5eEbP6ZLLOX3tKdbGgfGBCI/FHRkzCO4p7gLumWqa turtle"
SMALLEST_RSA_BITS = 2048
ECDSA_CURVES = ("nistp256", "nistp384", "nistp521")
ED25519 = "ssh-ed25519"
SK_ED25519 = "sk-ssh-ed25519@openssh.com"
SK_ECDSA = "sk-ecdsa-sha2-nistp256@openssh.com"
ROBOT_TYPES = (ED25519, *(f"ecdsa-sha2-{curve}" for curve in ECDSA_CURVES), "ssh-rsa")
# A robot cannot touch a security key, a person can.
PERSON_TYPES = (*ROBOT_TYPES, SK_ED25519, SK_ECDSA)
ED25519_BYTES = 32


MAX_SIGNATURE_LENGTH = 4096
SIGNER = "robot"
SIGNATURE_TIMEOUT_S = 5


@dataclass(frozen=True)
class PublicKey:
    """A key: `line` is `TYPE BASE64`, `fingerprint` as `ssh-keygen -l` prints it."""

    line: str
    fingerprint: str


def parse(text: str) -> PublicKey:
    """Return a robot's key of one line; raise FieldInvalid when it is none that robots may use."""
    return _parse(text, ROBOT_TYPES)


def parse_persons(text: str) -> PublicKey:
    """Return a person's key of one line; raise FieldInvalid when it is none that people may use."""
    return _parse(text, PERSON_TYPES)


def comment(text: str) -> str:
    """Return the comment after the key, or an empty text."""
    return " ".join(text.split()[2:])


def _parse(text: str, types: tuple[str, ...]) -> PublicKey:
    words = text.strip().split(" ")
    if len(text) > MAX_LINE_LENGTH or not text.strip().isprintable() or len(words) < 2:  # noqa: PLR2004 - type and key
        raise _invalid("it must be one line: type, key and perhaps a comment")
    kind, encoded = words[:2]
    if kind not in types:
        raise _invalid(f"its type is not one of {', '.join(types)} (options are not allowed)")
    try:
        blob = base64.b64decode(encoded, validate=True)
        fields = _fields(blob)
    except (binascii.Error, struct.error, ValueError) as error:
        raise _invalid("its base64 is damaged") from error
    _check_fields(kind, fields)
    digest = base64.b64encode(hashlib.sha256(blob).digest()).decode().rstrip("=")
    return PublicKey(f"{kind} {base64.b64encode(blob).decode()}", f"SHA256:{digest}")


def _fields(blob: bytes) -> list[bytes]:
    """Split SSH's wire format (RFC 4251): fields of a four-byte length and that many bytes."""
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


def _check_fields(kind: str, fields: list[bytes]) -> None:
    if not fields or fields[0] != kind.encode():
        raise _invalid("the key inside is of another type than the line says")
    match kind, fields[1:]:
        case "ssh-ed25519", [point] if len(point) == ED25519_BYTES:
            return
        case "sk-ssh-ed25519@openssh.com", [point, _] if len(point) == ED25519_BYTES:
            return
        case "sk-ecdsa-sha2-nistp256@openssh.com", [b"nistp256", _, _]:
            return
        case "ssh-rsa", [_, modulus]:
            bits = int.from_bytes(modulus, "big").bit_length()
            if bits < SMALLEST_RSA_BITS:
                raise _invalid(
                    f"an RSA key needs {SMALLEST_RSA_BITS} bits or more, this has {bits}"
                )
            return
        case _, [curve, _] if kind == f"ecdsa-sha2-{curve.decode('ascii', 'replace')}":
            return
    raise _invalid("its base64 is damaged")


def _invalid(why: str) -> FieldInvalid:
    return FieldInvalid(f"cannot use public_key: {why}; an ssh-ed25519 key is best", "public_key")


def signature_holds(key: PublicKey, namespace: str, message: str, signature: str) -> bool:
    """Tell whether `ssh-keygen -Y sign` made the signature over the message with that key, for that namespace.

    Asks ssh-keygen: OpenSSH reads its own format (PROTOCOL.sshsig), which the library `cryptography` does not know.
    Must never be given a key that did not pass `parse`.

    Raises OSError when there is no ssh-keygen, and subprocess.TimeoutExpired.
    """
    with TemporaryDirectory(prefix="robotether-") as folder:
        signers, file = Path(folder, "signers"), Path(folder, "signature")
        signers.write_text(f'{SIGNER} namespaces="{namespace}" {key.line}\n', encoding="ascii")
        file.write_text(signature, encoding="utf-8")
        signer = ("-f", str(signers), "-I", SIGNER, "-n", namespace)
        done = subprocess.run(  # noqa: S603 - fixed words, and paths of ours
            ["ssh-keygen", "-Y", "verify", *signer, "-s", str(file)],  # noqa: S607 - PATH is the image's
            input=message.encode(),
            capture_output=True,
            check=False,
            timeout=SIGNATURE_TIMEOUT_S,
        )
    if done.returncode != 0:
        logger.info("signature of key %s refused: %r", key.fingerprint, done.stderr[-200:])
    return done.returncode == 0
