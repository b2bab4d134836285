"""People's SSH keys."""

from __future__ import annotations

import pytest
from robotether_server.db import Database, user_keys, users
from robotether_server.problems import RecordExists, RecordMissing
from robotether_server.ssh_keys import PublicKey

KEY = PublicKey("ssh-ed25519 AAAA", "SHA256:a")
OTHER_KEY = PublicKey("ssh-ed25519 BBBB", "SHA256:b")


def test_keys_belong_to_one_user(database: Database) -> None:
    """Neither name nor key twice for one; another user may have the same, and sees no other's."""
    with database.transaction() as tx:
        ann, bob = (
            users.get(tx, name) for name in ("ann", "bob") if users.add(tx, name, "x", "user")
        )
        added = user_keys.add(tx, ann, "desk", KEY)
        assert (added.name, added.public_key, added.fingerprint) == ("desk", KEY.line, "SHA256:a")
        with pytest.raises(RecordExists, match="has this very key"):
            user_keys.add(tx, ann, "other", KEY)
        with pytest.raises(RecordExists, match="has a key of that name"):
            user_keys.add(tx, ann, "desk", OTHER_KEY)
        bobs = user_keys.add(tx, bob, "desk", KEY)
        assert user_keys.list_of(tx, ann) == [added]
        with pytest.raises(RecordMissing, match="user ann has none of that number"):
            user_keys.get(tx, ann, bobs.id)
        user_keys.delete(tx, added.id)
        assert (user_keys.list_of(tx, ann), user_keys.list_of(tx, bob)) == ([], [bobs])
        users.remove(tx, bob.id)
        assert tx.rows("SELECT * FROM user_ssh_keys") == []
