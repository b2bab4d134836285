"""The dates of a certificate, read from its own bytes."""

from __future__ import annotations

import ssl
from datetime import datetime, timezone

import pytest
from dated_certificate import der_of, make_certificate
from fake_cloud import certificate
from robotether_agent.doctor.certificate import CertificateError, validity

UTC = timezone.utc


@pytest.mark.parametrize(
    "end", [datetime(2030, 1, 2, 3, 4, 5, tzinfo=UTC), datetime(2077, 1, 1, tzinfo=UTC)]
)
def test_both_spellings_of_a_date_are_read(place, end):
    """From 2050 on the year has four digits."""
    begin = datetime(2024, 5, 6, 7, 8, 9, tzinfo=UTC)
    assert validity(der_of(make_certificate(place, begin, end))) == (begin, end)


def test_openssls_own_certificate_is_read():
    """As a server makes it with the command line."""
    pem = certificate().read_text().split("-----END CERTIFICATE-----")[0]
    begin, end = validity(ssl.PEM_cert_to_DER_cert(pem + "-----END CERTIFICATE-----\n"))
    assert (end - begin).days == 2


def test_rubbish_is_told_as_such(place):
    """Whatever a stranger shows, and wherever it is cut short, there is one kind of error."""
    whole = der_of(
        make_certificate(place, datetime(2024, 1, 1, tzinfo=UTC), datetime(2025, 1, 1, tzinfo=UTC))
    )
    for data in (b"", b"\x30", b"<html>Welcome", *(whole[:at] for at in range(0, 150, 7))):
        with pytest.raises(CertificateError):
            validity(data)
