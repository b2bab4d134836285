"""Secret texts that clients keep, of which the database keeps only the SHA-256.

A plain hash is enough, as each text holds 32 random bytes; nobody can try them all.
"""

import hashlib
import secrets

RANDOM_BYTES = 32


def new_text(prefix: str = "") -> str:
    """Return a new secret in URL-safe base64, after the prefix."""
    return prefix + secrets.token_urlsafe(RANDOM_BYTES)


def digest(text: str) -> bytes:
    """Return the value of the column token_hash for this text.

    Headers and JSON may hold halves of characters, as which bytes over 0x7F are read: no text of ours has any.
    """
    return hashlib.sha256(text.encode(errors="surrogatepass")).digest()
