"""Looks up logins and API tokens, and ends what depends on one that is gone.

`access` asks for every request without a ticket. Answers are kept for a few seconds, so that a page with many videos
asks the database once. However many strangers ask, the database has two open questions about them: one for stops, one
for the rest. `fleet` asks again about credentials with an open connection. While the database is away, such a
credential stays valid as long as the connection, and a while longer. The credential of a person who begins to drive is
checked each time, and while the database is away trusted in the same way, as is a ticket that another cell's web has
signed with the database since.
"""

from __future__ import annotations

import asyncio
from collections import Counter, OrderedDict
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager

from robotether_server.db.credentials import digest
from robotether_server.db.fleet import Credential, RelayUser
from robotether_server.problems import StoreUnavailableError, ThrottledError
from robotether_server.relay.records.database import RelayDatabase
from robotether_server.tickets import CredentialKind

KEEP_S = 3.0
MAX_KEPT = 10_000
# Time after its last use in which a credential may begin a drive while the database is down.
RECENT_S = 15 * 60.0
MAX_RECENT = 1000
# Minimum time by which a ticket must be newer than the last answer: its signer's clock may be ahead
# (`MAX_TICKET_AHEAD_S`), and the signer read the credential before the rest, each for at most
# `BRIEF_TIMEOUT_S`.
NEWER_BY_S = 6.0
# Maximum number of unknown credentials in one question to the database.
MAX_IN_QUESTION = 100
# Maximum number of unknown credentials that wait for an answer, of one address and of all.
MAX_WAITING_OF_ADDRESS = 50
MAX_WAITING = 2000
THROTTLED_S = 1

UsersOf = Callable[[list[Credential]], Awaitable[Mapping[Credential, RelayUser]]]


def credential_of(kind: CredentialKind, text: str) -> Credential:
    """Name a credential by its digest, which is all that the database keeps."""
    return Credential(kind, digest(text))


class SharedQuestions:
    """Asks about credentials of strangers: one question at a time, about all that wait for it.

    A question for each would take the places of the relay's own duties in the database's queue.
    """

    def __init__(self, ask: UsersOf) -> None:
        self._ask = ask
        # Not those whose question is open: its answer may be of before a change.
        self._waiting: dict[Credential, asyncio.Future[RelayUser | None]] = {}
        self._of_address: Counter[str] = Counter()
        self._asking: asyncio.Task[None] | None = None

    async def user_of(self, credential: Credential, address: str) -> RelayUser | None:
        """Return who the credential belongs to; raise ThrottledError or StoreUnavailableError."""
        if (answer := self._waiting.get(credential)) is None:
            answer = self._wait_for(credential, address)
        # Several may wait for it, and one of them may leave.
        return await asyncio.shield(answer)

    def _wait_for(self, credential: Credential, address: str) -> asyncio.Future[RelayUser | None]:
        if self._of_address[address] >= MAX_WAITING_OF_ADDRESS or (
            self._of_address.total() >= MAX_WAITING
        ):
            raise ThrottledError(
                "cannot identify the caller now: too many requests wait to be identified; try again shortly",
                THROTTLED_S,
            )
        answer = self._waiting[credential] = asyncio.get_running_loop().create_future()
        self._of_address[address] += 1
        answer.add_done_callback(lambda _answer: self._on_answer(address))
        if self._asking is None:
            self._asking = asyncio.create_task(self._ask_all(), name="unknown credentials")
        return answer

    def _on_answer(self, address: str) -> None:
        self._of_address[address] -= 1
        if not self._of_address[address]:
            del self._of_address[address]

    async def _ask_all(self) -> None:
        try:
            while self._waiting:
                credentials = list(self._waiting)[:MAX_IN_QUESTION]
                await self._answer(
                    {credential: self._waiting.pop(credential) for credential in credentials}
                )
        finally:
            self._asking = None

    async def _answer(self, answers: Mapping[Credential, asyncio.Future[RelayUser | None]]) -> None:
        try:
            users = await self._ask(list(answers))
        except Exception as problem:  # noqa: BLE001  # who waits raises it
            for answer in answers.values():
                answer.set_exception(problem)
                # Whoever waited may be gone.
                answer.exception()
        else:
            for credential, answer in answers.items():
                answer.set_result(users.get(credential))


class Credentials:
    """Looks credentials up, and watches those on which something live depends."""

    def __init__(self, database: RelayDatabase) -> None:
        self._database = database
        self._questions = SharedQuestions(self._users_of)
        # A stop does not wait for an answer about other credentials.
        self._stop_questions = SharedQuestions(self._users_of)
        self._cache: OrderedDict[Credential, tuple[float, RelayUser | None]] = OrderedDict()
        self._watchers: dict[Credential, set[Callable[[], None]]] = {}
        self._unchecked: set[Credential] = set()
        # Of those held, whose they were when last asked for; what hangs on one ends when it does.
        self._live: dict[Credential, RelayUser] = {}
        # When the database last said of those in use that they hold, and whose they were, the oldest first.
        self._recent: dict[Credential, tuple[float, RelayUser]] = {}
        self._rechecks = 0
        # When the database last answered, about whatever.
        self._answered_at: float | None = None

    async def user_of(
        self, credential: Credential, address: str = "", *, stops: bool = False
    ) -> RelayUser | None:
        """Return who the credential belongs to; None: it does not hold. May raise StoreUnavailableError or Throttled.

        `address` is where it was sent from, `stops`: to stop robots.
        """
        if (live := self._live.get(credential)) is not None:
            # Else nobody could stop a robot over HTTP while the database is away.
            return live
        now = asyncio.get_running_loop().time()
        entry = self._cache.get(credential)
        if entry is not None and now - entry[0] < KEEP_S:
            return entry[1]
        rechecks = self._rechecks
        try:
            user = await self._ask_for(credential, address, stops=stops)
        except StoreUnavailableError:
            # Whoever may still begin to drive may stop a robot, too.
            if self._is_recent(credential):
                return self._recent[credential][1]
            raise
        if user is None:
            self._forget(credential)
        # An answer to a question of before a change may be the old one.
        if rechecks == self._rechecks:
            self._keep(credential, now, user)
        return user

    async def _ask_for(
        self, credential: Credential, address: str, *, stops: bool
    ) -> RelayUser | None:
        if self._is_recent(credential):
            return (await self._users_of([credential], briefly=True)).get(credential)
        questions = self._stop_questions if stops else self._questions
        return await questions.user_of(credential, address)

    async def holds(self, credential: Credential) -> bool:
        """Ask the database, whatever is cached; StoreUnavailableError if it is down and did not confirm it recently."""
        rechecks = self._rechecks
        try:
            users = await self._users_of([credential], briefly=True)
        except StoreUnavailableError:
            if self.held_lately(credential):
                return True
            raise
        if (user := users.get(credential)) is None:
            self._forget(credential)
        # As above.
        elif rechecks == self._rechecks:
            self._note_recent(credential, user)
        return user is not None

    def held_lately(self, credential: Credential) -> bool:
        """Return whether the database said so not long ago, or of what is live, and since then not the contrary."""
        return credential in self._live or self._is_recent(credential)

    def note_signed(self, credential: Credential, user: RelayUser, age_s: float) -> None:
        """Note what the database told web, which then signed a ticket; not if it has answered the relay since."""
        now = asyncio.get_running_loop().time()
        if self._answered_at is not None and age_s + NEWER_BY_S < now - self._answered_at:
            self._note_recent(credential, user)

    @contextmanager
    def held(self, credential: Credential, end: Callable[[], None]) -> Iterator[None]:
        """Call `end` when the credential stops holding inside the block, or did so just before."""
        ends = self._watchers.setdefault(credential, set())
        ends.add(end)
        self._unchecked.add(credential)
        try:
            yield
        finally:
            ends.discard(end)
            if not ends and self._watchers.get(credential) is ends:
                del self._watchers[credential]
                self._unchecked.discard(credential)
                self._live.pop(credential, None)

    async def recheck(self, *, changed: bool = True) -> None:
        """Ask again for all that is held or was lately, and end what hangs on the rest.

        `changed`: the database says that one of all credentials has changed.
        """
        # The database has just answered: something may have changed, even if what follows gets no answer.
        self._note_answer()
        self._cache.clear()
        self._rechecks += 1
        recent = {key: entry for key, entry in self._recent.items() if self._is_recent(key)}
        if changed:
            # Without an answer none of these is believed: what has changed may be its end.
            self._recent = {}
        valid = await self._ask_again([*self._watchers, *(recent.keys() - self._watchers.keys())])
        still_valid = {key: entry for key, entry in recent.items() if key in valid}
        self._recent = {**still_valid, **self._recent}

    async def check_new(self) -> None:
        """Ask for those held since the last time: they may have ended while the way was long."""
        # The database has just answered: nothing has changed.
        self._note_answer()
        await self._ask_again(list(self._unchecked))

    async def _ask_again(self, credentials: list[Credential]) -> Mapping[Credential, RelayUser]:
        """Return those that hold, by their users."""
        if not credentials:
            return {}
        valid = await self._users_of(credentials)
        self._unchecked.difference_update(credentials)
        for credential in credentials:
            if credential in valid:
                if credential in self._watchers:
                    self._live[credential] = valid[credential]
                    self._note_recent(credential, valid[credential])
            else:
                self._forget(credential)
                for end in list(self._watchers.get(credential, ())):
                    end()
        return valid

    async def _users_of(
        self, credentials: list[Credential], *, briefly: bool = False
    ) -> Mapping[Credential, RelayUser]:
        users = await self._database.users_of(credentials, briefly=briefly)
        self._note_answer()
        return users

    def _note_answer(self) -> None:
        self._answered_at = asyncio.get_running_loop().time()

    def _forget(self, credential: Credential) -> None:
        self._live.pop(credential, None)
        self._recent.pop(credential, None)

    def _note_recent(self, credential: Credential, user: RelayUser) -> None:
        self._recent.pop(credential, None)
        self._recent[credential] = asyncio.get_running_loop().time(), user
        while len(self._recent) > MAX_RECENT:
            del self._recent[next(iter(self._recent))]

    def _is_recent(self, credential: Credential) -> bool:
        entry = self._recent.get(credential)
        return entry is not None and asyncio.get_running_loop().time() - entry[0] < RECENT_S

    def _keep(self, credential: Credential, now: float, user: RelayUser | None) -> None:
        self._cache[credential] = (now, user)
        self._cache.move_to_end(credential)
        while len(self._cache) > MAX_KEPT:
            self._cache.popitem(last=False)
