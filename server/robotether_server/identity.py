"""What names a robot, its MAC, and what proves it, its public key; people's public keys are read here, too.

Used by api, web, services and db. A MAC is written in one spelling, `00:1b:44:11:3a:b7`, and refused where no robot has
it: the twin of the procedure normalise_mac in sql/0006_shell_ports_and_macs.sql, which serves whoever writes SQL by
hand; a test holds the two together. What is returned of a key is written into sshd's answer to AuthorizedKeysCommand,
so nothing passes but a key type and its base64: no options, no comment, no second line.
"""

import base64
import hashlib
import re
from dataclasses import dataclass

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPublicKey
from cryptography.hazmat.primitives.serialization import load_ssh_public_key

from robotether_server.problems import FieldInvalidError

MAX_MAC_LENGTH = 40
ZERO_MAC = "00:00:00:00:00:00"
# Bits of a MAC's first byte: for many machines at once, and given by a machine to itself (IEEE
# 802).
MULTICAST = 0x01
LOCAL = 0x02

_MAC_SPELLINGS = re.compile(
    r"([0-9a-f]{1,2}:){5}[0-9a-f]{1,2}"  # some systems print 0 for 00
    r"|([0-9a-f]{1,2}-){5}[0-9a-f]{1,2}"
    r"|([0-9a-f]{4}[.]){2}[0-9a-f]{4}"
    r"|[0-9a-f]{12}"
)

MAX_KEY_LENGTH = 2048
EXAMPLE_KEY = (
    "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIJo5eEbP6ZLLOX3tKdbGgfGBCI/FHRkzCO4p7gLumWqa turtle"
)
SMALLEST_RSA_BITS = 2048
ROBOT_TYPES = ("ssh-ed25519", *(f"ecdsa-sha2-nistp{bits}" for bits in (256, 384, 521)), "ssh-rsa")
# A robot cannot touch a security key, a person can.
PERSON_TYPES = (
    *ROBOT_TYPES,
    "sk-ssh-ed25519@openssh.com",
    "sk-ecdsa-sha2-nistp256@openssh.com",
)
MAX_SIGNATURE_LENGTH = 4096


def normalise_mac(text: str, *, allow_local: bool = True) -> str:
    """Return the MAC in lower case with colons; raise FieldInvalidError when it is none that a robot may have."""
    lower = text.strip(" ").lower()
    if not _MAC_SPELLINGS.fullmatch(lower):
        raise FieldInvalidError(
            f"cannot use mac {text[:MAX_MAC_LENGTH]!r}: it is not a MAC address; write it as 00:1b:44:11:3a:b7",
            "mac",
        )
    digits = "".join(part.zfill(2) for part in re.split("[:.-]", lower))
    mac = ":".join(digits[at : at + 2] for at in range(0, len(digits), 2))
    if mac == ZERO_MAC or _first_byte(mac) & MULTICAST:
        raise FieldInvalidError(
            f"cannot use mac {text[:MAX_MAC_LENGTH]!r}: it is all zero, broadcast or multicast, which no single "
            "robot has; give that of its network card",
            "mac",
        )
    if not allow_local:
        check_universal_mac(mac)
    return mac


def check_universal_mac(mac: str) -> None:
    """Raise FieldInvalidError for a MAC that a machine gave itself: another may have given itself the same."""
    if _first_byte(mac) & LOCAL:
        raise FieldInvalidError(
            f"cannot use mac {mac}: it is locally administered, as those of virtual machines and containers "
            "are; give that of a network card, or let an admin allow it: with the box in the page's form, or "
            "robotether robot add NAME --mac MAC --allow-local-mac",
            "mac",
        )


def _first_byte(mac: str) -> int:
    return int(mac[:2], 16)


@dataclass(frozen=True)
class PublicKey:
    """A key: `line` is `TYPE BASE64`, `fingerprint` as `ssh-keygen -l` prints it."""

    line: str
    fingerprint: str


def parse_robots_key(text: str) -> PublicKey:
    """Return a robot's key of one line; raise FieldInvalidError when it is none that robots may use."""
    return _parse_key(text, ROBOT_TYPES)


def parse_persons_key(text: str) -> PublicKey:
    """Return a person's key of one line; raise FieldInvalidError when it is none that people may use."""
    return _parse_key(text, PERSON_TYPES)


def key_comment(text: str) -> str:
    """Return the comment after the key, or an empty text."""
    return " ".join(text.split()[2:])


def _parse_key(text: str, types: tuple[str, ...]) -> PublicKey:
    if "PRIVATE KEY-----" in text:
        raise FieldInvalidError(
            "cannot use public_key: this is a private key, which must never leave its machine; give the line of "
            "the file that ends in .pub",
            "public_key",
        )
    words = text.split()
    if len(text) > MAX_KEY_LENGTH or not text.strip().isprintable() or len(words) < 2:  # noqa: PLR2004 - type and key
        raise _invalid("it must be one line: type, key and perhaps a comment")
    kind, encoded = words[:2]
    if kind not in types:
        raise _invalid(f"its type is not one of {', '.join(types)} (options are not allowed)")
    try:
        blob = base64.b64decode(encoded, validate=True)
        key = load_ssh_public_key(f"{kind} {encoded}".encode())
    except (ValueError, UnsupportedAlgorithm, NotImplementedError) as error:
        raise _invalid("its base64 is damaged, or that of another type") from error
    if isinstance(key, RSAPublicKey) and key.key_size < SMALLEST_RSA_BITS:
        raise _invalid(
            f"an RSA key needs {SMALLEST_RSA_BITS} bits or more, this has {key.key_size}"
        )
    return PublicKey(f"{kind} {base64.b64encode(blob).decode()}", fingerprint_of(blob))


def fingerprint_of(blob: bytes) -> str:
    """Return the fingerprint of a key in SSH's wire format, as `ssh-keygen -l` prints it."""
    digest = base64.b64encode(hashlib.sha256(blob).digest()).decode().rstrip("=")
    return f"SHA256:{digest}"


def _invalid(why: str) -> FieldInvalidError:
    return FieldInvalidError(
        f"cannot use public_key: {why}; an ssh-ed25519 key is best", "public_key"
    )
