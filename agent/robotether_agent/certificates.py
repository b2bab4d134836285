"""Lets aiohttp read the system's certificates when a connection needs them, not twice when it is imported.

They take 2 MB and a good part of the start, and few robots need them: the server's are read by `enrolment.join`, and
rosbridge and cameras have TLS seldom. Imported by the programs before anything that imports aiohttp; imported later, it
changes nothing but that they are read once more. A context whose certificates were not read trusts nobody.
"""

from __future__ import annotations

import ssl
from typing import Any


class CertificatesOnDemand(ssl.SSLContext):
    """A context that becomes an ordinary one with the first connection."""

    def wrap_bio(self, *args: Any, **kwargs: Any) -> ssl.SSLObject:
        """Read the certificates first."""
        self.load_default_certs()
        self.__class__ = ssl.SSLContext  # type: ignore[assignment]
        return self.wrap_bio(*args, **kwargs)


def _read_nothing(*_: object) -> None:
    """Take the place of what reads certificates."""


_load_default_certs = ssl.SSLContext.load_default_certs
ssl.SSLContext.load_default_certs = _read_nothing  # type: ignore[method-assign, assignment]
ssl.SSLContext.set_default_verify_paths = _read_nothing  # type: ignore[method-assign, assignment]
try:
    from aiohttp import connector
finally:
    ssl.SSLContext.load_default_certs = _load_default_certs  # type: ignore[method-assign]
    # It is the base class's own again.
    del ssl.SSLContext.set_default_verify_paths

connector._SSL_CONTEXT_VERIFIED.__class__ = CertificatesOnDemand
