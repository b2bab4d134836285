"""What server and robot sign of the audit log (docs/reference/audit-log.md): the newest line of a robot's chain."""

from __future__ import annotations

# Of the signatures that `ssh-keygen -Y sign` makes: one for this counts nowhere else.
NAMESPACE = "robotether-audit"
# Maximum position that is signed; each is exact in JSON.
MAX_POSITION = 2**53 - 1
# Maximum number of statements that a robot keeps until the server has them.
MAX_STATEMENTS = 50


def statement(chain: str, position: int, line_hash: str, previous: str | None) -> str:
    """Return what is signed; `previous` is the SHA-256 in hex of the signer's statement before, None: it has none."""
    return (
        f"robotether audit head 1\nchain {chain}\nposition {position}\nhash {line_hash}\n"
        f"previous {previous or '-'}\n"
    )
