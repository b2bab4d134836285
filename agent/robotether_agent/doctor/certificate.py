"""Reads from a certificate when it is valid, without trusting it: Python tells that of trusted ones only."""

from __future__ import annotations

from datetime import datetime, timezone

SEQUENCE, VERSION, UTC_TIME, GENERALIZED_TIME = 0x30, 0xA0, 0x17, 0x18
FORMATS = {UTC_TIME: "%y%m%d%H%M%SZ", GENERALIZED_TIME: "%Y%m%d%H%M%SZ"}
LONG_LENGTH = 0x80


class CertificateError(ValueError):
    """The bytes are no certificate that can be read."""


def validity(der: bytes) -> tuple[datetime, datetime]:
    """Return the first and the last moment of an X.509 certificate in DER (RFC 5280, 4.1)."""
    try:
        _, certificate, _ = _read(der)
        _, signed, _ = _read(certificate)
        tag, _, rest = _read(signed)
        # A version may stand first; then come a number, an algorithm, the issuer, and the dates.
        for _ in range(3 if tag == VERSION else 2):
            _, _, rest = _read(rest)
        tag, dates, _ = _read(rest)
        if tag != SEQUENCE:
            raise CertificateError("no dates where they should be")
        begin_tag, begin, rest = _read(dates)
        end_tag, end, _ = _read(rest)
        return _time(begin_tag, begin), _time(end_tag, end)
    except (IndexError, KeyError, ValueError) as error:
        raise CertificateError(f"not a certificate: {error}") from error


def _read(data: bytes) -> tuple[int, bytes, bytes]:
    """Return tag and content of the first value in `data`, and what follows it."""
    length, start = data[1], 2
    if length & LONG_LENGTH:
        start += length ^ LONG_LENGTH
        length = int.from_bytes(data[2:start], "big")
    if start + length > len(data):
        raise CertificateError("cut short")
    return data[0], data[start : start + length], data[start + length :]


def _time(tag: int, text: bytes) -> datetime:
    return datetime.strptime(text.decode("ascii"), FORMATS[tag]).replace(tzinfo=timezone.utc)
