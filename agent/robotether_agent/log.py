"""Sets up the log: readable sentences on stderr, with priorities for the journal under systemd.

Called once by the cli.
"""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Mapping

# syslog's numbers, which journald takes off the line again.
PRIORITIES = {
    logging.DEBUG: 7,
    logging.INFO: 6,
    logging.WARNING: 4,
    logging.ERROR: 3,
    logging.CRITICAL: 2,
}


class JournalFormatter(logging.Formatter):
    """For the journal, which adds time and unit by itself."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record with its priority in front of each line."""
        prefix = f"<{PRIORITIES.get(record.levelno, 6)}>"
        return "\n".join(prefix + line for line in super().format(record).splitlines())


def set_up(level: str, environ: Mapping[str, str]) -> None:
    """Send the log to stderr from `level` on."""
    formatter = logging.Formatter(
        "%(asctime)s.%(msecs)03dZ %(levelname)s %(message)s", "%Y-%m-%dT%H:%M:%S"
    )
    formatter.converter = time.gmtime
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JournalFormatter() if "JOURNAL_STREAM" in environ else formatter)
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    # Its debug lines are about this process's own event loop.
    logging.getLogger("asyncio").setLevel(logging.WARNING)
