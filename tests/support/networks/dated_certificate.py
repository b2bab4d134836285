"""Certificates for localhost, valid now or, for robots whose clock is wrong, at another time."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from ipaddress import ip_address
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID


def make_certificate(
    place: Path, begin: datetime | None = None, end: datetime | None = None
) -> Path:
    now = datetime.now(timezone.utc)
    begin, end = begin or now - timedelta(days=1), end or now + timedelta(days=1)
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "localhost")])
    names = x509.SubjectAlternativeName(
        [x509.DNSName("localhost"), x509.IPAddress(ip_address("127.0.0.1"))]
    )
    builder = x509.CertificateBuilder(
        subject_name=name,
        issuer_name=name,
        public_key=key.public_key(),
        serial_number=x509.random_serial_number(),
        not_valid_before=begin,
        not_valid_after=end,
    )
    made = builder.add_extension(names, critical=False).sign(key, hashes.SHA256())
    file = place / f"certificate-{begin:%Y%m%d}.pem"
    file.write_bytes(
        made.public_bytes(serialization.Encoding.PEM)
        + key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
    )
    return file


def fingerprint_of(file: Path) -> str:
    made = x509.load_pem_x509_certificate(file.read_bytes())
    return made.fingerprint(hashes.SHA256()).hex()
