"""A disk that takes no writes, for tests of what goes on without it."""

from __future__ import annotations

import errno
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn


@contextmanager
def full_disk() -> Iterator[None]:
    """Let this process write into no file, as on a full disk, even as root.

    The fake cloud lives in the same process: in its mode refuses_key its join writes none.
    """
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def read_only(*_: object) -> NoReturn:
    """Fail as every write to a file system does that the kernel took the writes from."""
    raise OSError(errno.EROFS, "Read-only file system")
