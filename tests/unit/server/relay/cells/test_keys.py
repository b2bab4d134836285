"""The certificate of the cells, as files."""

import hashlib

import pytest
from robotether_server.relay.cells.keys import CERTIFICATE, KEY, read_peer_keys


def test_the_proof_is_the_hash_that_nginx_makes(keys_dir):
    keys = read_peer_keys(keys_dir)
    proof = hashlib.sha256((keys_dir / KEY).read_bytes()).hexdigest()
    assert keys.is_proof(proof)
    assert not keys.is_proof(proof[:-1])
    assert not keys.is_proof("")
    assert not keys.is_proof("ä")
    assert proof not in repr(keys)


@pytest.mark.parametrize("missing", [CERTIFICATE, KEY])
def test_a_cell_without_a_pair_has_no_peers(keys_dir, tmp_path, missing):
    for name in {CERTIFICATE, KEY} - {missing}:
        (tmp_path / name).write_bytes((keys_dir / name).read_bytes())
    assert read_peer_keys(tmp_path) is None
