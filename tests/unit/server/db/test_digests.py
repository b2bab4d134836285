"""Secret texts and what the database keeps of them."""

from __future__ import annotations

import hashlib

from robotether_server.db import digests


def test_texts_differ_and_are_long() -> None:
    """32 random bytes in URL-safe base64, after the prefix."""
    made = {digests.new_text("rt_") for _ in range(20)}
    assert len(made) == 20
    assert all(len(text) == 3 + 43 and text.startswith("rt_") for text in made)


def test_digest_is_sha256_of_the_whole_text() -> None:
    """As docs/reference/protocols.md says, so the relay finds the same row."""
    assert digests.digest("rt_abc") == hashlib.sha256(b"rt_abc").digest()


def test_half_a_character_has_a_digest_of_its_own() -> None:
    """So bytes in a header that are no text are an unknown login, and not an error."""
    assert digests.digest("\udcff") not in {digests.digest(""), digests.digest("?")}
