"""Logins and API tokens: who they belong to, and ending what hangs on one that is gone.

`access` asks for every request that comes without a ticket. Answers are kept a few seconds, so that
a page with many pictures asks the database once.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from robotether_server.relay.records import Records
from robotether_server.store.digests import digest
from robotether_server.store.fleet import Credential, CredentialKind, User

KEEP_S = 3.0
MAX_KEPT = 10_000


def credential_of(kind: CredentialKind, text: str) -> Credential:
    """Name a credential by its digest, which is all that the database keeps."""
    return Credential(kind, digest(text))


class Credentials:
    """Looks credentials up, and watches those on which something live depends."""

    def __init__(self, records: Records) -> None:
        self._records = records
        self._kept: OrderedDict[Credential, tuple[float, User | None]] = OrderedDict()
        self._held: dict[Credential, set[Callable[[], None]]] = {}

    async def user_of(self, credential: Credential) -> User | None:
        """Tell who the credential belongs to; None: it does not hold. May raise StoreUnavailable."""
        now = asyncio.get_running_loop().time()
        kept = self._kept.get(credential)
        if kept is not None and now - kept[0] < KEEP_S:
            return kept[1]
        user = (await self._records.users_of([credential])).get(credential)
        self._kept[credential] = (now, user)
        self._kept.move_to_end(credential)
        while len(self._kept) > MAX_KEPT:
            self._kept.popitem(last=False)
        return user

    @contextmanager
    def held(self, credential: Credential | None, end: Callable[[], None]) -> Iterator[None]:
        """Call `end` when the credential stops holding inside the block."""
        if credential is None:
            yield
            return
        ends = self._held.setdefault(credential, set())
        ends.add(end)
        try:
            yield
        finally:
            ends.discard(end)
            if not ends:
                self._held.pop(credential, None)

    async def recheck(self) -> None:
        """Ask again for all that is held, and end what hangs on the rest."""
        self._kept.clear()
        if not self._held:
            return
        valid = await self._records.users_of(list(self._held))
        for credential in [held for held in self._held if held not in valid]:
            for end in list(self._held.get(credential, ())):
                end()
