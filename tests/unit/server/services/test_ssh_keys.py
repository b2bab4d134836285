"""SSH keys that people upload."""

from __future__ import annotations

import pytest
from joins import Site
from robot_signer import RobotSigner
from robotether_server.db import users
from robotether_server.db.audit import Source
from robotether_server.problems import FieldInvalid, NotPossible, RecordExists, RecordMissing
from robotether_server.services import ssh_keys

ANN = Source("ann")


@pytest.fixture(scope="module")
def signer(tmp_path_factory: pytest.TempPathFactory) -> RobotSigner:
    """A real key, with the comment `robot`."""
    return RobotSigner(tmp_path_factory.mktemp("key"))


def test_key_is_named_by_its_comment_unless_a_name_is_given(
    site: Site, signer: RobotSigner
) -> None:
    """Without either, by its fingerprint."""
    bare = signer.key.line
    with site.database.transaction() as tx:
        ann = users.get(tx, "ann")
        for name, line, expected in (
            ("desk", signer.line, "desk"),
            (None, signer.line, "robot"),
            ("", bare, signer.key.fingerprint),
        ):
            key = ssh_keys.add(tx, ANN, ann, name, line)
            assert (key.name, key.public_key) == (expected, bare)
            assert ssh_keys.list_of(tx, ann) == [key]
            with pytest.raises(RecordExists):
                ssh_keys.add(tx, ANN, ann, "again", line)
            assert ssh_keys.delete(tx, ANN, ann, key.id) == key
    assert (len(site.events("ssh_key_added")), len(site.events("ssh_key_deleted"))) == (3, 3)


def test_other_peoples_keys_are_out_of_reach(site: Site, signer: RobotSigner) -> None:
    """Their numbers are as unknown as those of no key."""
    with site.database.transaction() as tx:
        ann, root = users.get(tx, "ann"), users.get(tx, "root")
        key = ssh_keys.add(tx, ANN, ann, "desk", signer.line)
        with pytest.raises(RecordMissing):
            ssh_keys.delete(tx, Source("root"), root, key.id)


def test_what_is_no_key_is_refused(site: Site, signer: RobotSigner) -> None:
    """Options above all; and a name that would break a table."""
    with site.database.transaction() as tx:
        ann = users.get(tx, "ann")
        for line in ("", "rubbish", f'command="sh" {signer.line}', f"{signer.line}\n{signer.line}"):
            with pytest.raises(FieldInvalid, match="cannot use public_key"):
                ssh_keys.add(tx, ANN, ann, "desk", line)
        with pytest.raises(FieldInvalid, match="cannot use name"):
            ssh_keys.add(tx, ANN, ann, "de\tsk", signer.line)


def test_a_user_has_so_many_keys_at_most(
    site: Site, signer: RobotSigner, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each is a line that sshd is told at a log-in."""
    monkeypatch.setattr(ssh_keys, "MAX_KEYS", 0)
    with site.database.transaction() as tx, pytest.raises(NotPossible, match="delete one"):
        ssh_keys.add(tx, ANN, users.get(tx, "ann"), "desk", signer.line)
