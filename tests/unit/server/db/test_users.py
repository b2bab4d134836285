"""Users and their SSH keys in the real database."""

import pytest
from robotether_server.db import users
from robotether_server.identity import PublicKey
from robotether_server.problems import RecordExistsError, RecordMissingError


def test_user_is_found_by_name(database):
    """What was added comes back; the hash stays out of printed objects."""
    with database.transaction() as tx:
        user_id = users.add(tx, "ann", "hash-of-ann", "admin")
        user = users.get(tx, "ann")
        assert (user.id, user.name, user.is_admin, user.disabled) == (user_id, "ann", True, False)
        assert "hash-of-ann" not in repr(user)
        assert users.find(tx, "bob") is None
        assert [item.name for item in users.list_all(tx)] == ["ann"]


KEY = PublicKey("ssh-ed25519 AAAA", "SHA256:a")
OTHER_KEY = PublicKey("ssh-ed25519 BBBB", "SHA256:b")


def test_keys_belong_to_one_user(database):
    """Neither name nor key twice for one; another user may have the same, and sees no other's."""
    with database.transaction() as tx:
        ann, bob = (
            users.get(tx, name) for name in ("ann", "bob") if users.add(tx, name, "x", "user")
        )
        added = users.add_ssh_key(tx, ann, "desk", KEY)
        assert (added.name, added.public_key, added.fingerprint) == ("desk", KEY.line, "SHA256:a")
        with pytest.raises(RecordExistsError, match="has this very key"):
            users.add_ssh_key(tx, ann, "other", KEY)
        with pytest.raises(RecordExistsError, match="has a key of that name"):
            users.add_ssh_key(tx, ann, "desk", OTHER_KEY)
        bobs = users.add_ssh_key(tx, bob, "desk", KEY)
        assert users.list_ssh_keys(tx, ann) == [added]
        with pytest.raises(RecordMissingError, match="user ann has none of that number"):
            users.get_ssh_key(tx, ann, bobs.id)
        users.delete_ssh_key(tx, added.id)
        assert (users.list_ssh_keys(tx, ann), users.list_ssh_keys(tx, bob)) == ([], [bobs])
        users.remove(tx, bob.id)
        assert tx.rows("SELECT * FROM user_ssh_keys") == []
