"""Brings a MAC address into its one spelling, `00:1b:44:11:3a:b7`.

Used by web and cli before they ask the database. Twin of the procedure normalise_mac in
sql/0002_ports_and_macs.sql, which serves whoever writes SQL by hand; a test holds the two together.
"""

import re

from robotether_server.problems import FieldInvalid

_SPELLINGS = re.compile(
    r"([0-9a-f]{2}:){5}[0-9a-f]{2}"
    r"|([0-9a-f]{2}-){5}[0-9a-f]{2}"
    r"|([0-9a-f]{4}[.]){2}[0-9a-f]{4}"
    r"|[0-9a-f]{12}"
)


def normalise(text: str) -> str:
    """Return the MAC in lower case with colons; raise FieldInvalid when it is none."""
    lower = text.lower()
    if not _SPELLINGS.fullmatch(lower):
        raise FieldInvalid(
            f"cannot use mac {text[:40]!r}: it is no MAC address; write it as 00:1b:44:11:3a:b7"
        )
    digits = re.sub("[:.-]", "", lower)
    return ":".join(digits[at : at + 2] for at in range(0, len(digits), 2))
