"""The certificate and key that all cells of a site share, and what each proves with them.

`main` reads them once. Both ends of a connection between cells show this one certificate, and trust no other. nginx's
peer listener shows the relay a hash of the key, as other containers reach the relay's peer port, too.
"""

from __future__ import annotations

import hashlib
import hmac
import ssl
from dataclasses import dataclass, field
from pathlib import Path

SECRETS_DIR = Path("/run/secrets")
CERTIFICATE, KEY = "peer_cert.pem", "peer_key.pem"
# In the certificate, and in images/nginx/peer-forward.conf.
SERVER_NAME = "robotether-peer"
# In images/nginx/entrypoint.sh, which makes the same hash.
PROOF_HEADER = "Robotether-Peer"


@dataclass(frozen=True)
class PeerKeys:
    """What a cell shows to its peers, and what it demands of them."""

    tls: ssl.SSLContext = field(repr=False)
    proof: str = field(repr=False)

    def is_proof(self, proof: str) -> bool:
        """Return whether a request comes from nginx's peer listener."""
        return hmac.compare_digest(proof.encode(errors="surrogateescape"), self.proof.encode())


def read_peer_keys(folder: Path = SECRETS_DIR) -> PeerKeys | None:
    """Read certificate and key; None: there are none, and this cell has no peers."""
    certificate, key = folder / CERTIFICATE, folder / KEY
    if not (certificate.is_file() and key.is_file()):
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.load_verify_locations(certificate)
    context.load_cert_chain(certificate, key)
    return PeerKeys(context, hashlib.sha256(key.read_bytes()).hexdigest())
