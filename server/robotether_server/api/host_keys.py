"""Reads sshd's public host keys, which robots pin when they join.

sshd writes them to a volume that web sees read-only; they are read anew each time, as sshd may start later.
"""

from pathlib import Path

from robotether_server.problems import StoreUnavailable

KEY_WORDS = 2


def read(folder: Path) -> list[str]:
    """Return each key as `TYPE BASE64`, by file name; raise StoreUnavailable when there is none."""
    lines = []
    for path in sorted(folder.glob("*.pub")):
        words = path.read_text(encoding="ascii").split()
        if len(words) >= KEY_WORDS:
            lines.append(" ".join(words[:KEY_WORDS]))
    if not lines:
        raise StoreUnavailable(
            f"cannot tell sshd's host keys: {folder} holds no *.pub file yet; try again shortly"
        )
    return lines
