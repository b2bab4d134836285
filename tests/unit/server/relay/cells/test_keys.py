"""The certificate of the cells, as files."""

import hashlib

from robotether_server.relay.cells.keys import KEY, read_peer_keys


def test_the_proof_is_the_hash_that_nginx_makes(keys_dir):
    keys = read_peer_keys(keys_dir)
    proof = hashlib.sha256((keys_dir / KEY).read_bytes()).hexdigest()
    assert keys.is_proof(proof)
    assert not keys.is_proof(proof[:-1])
    assert not keys.is_proof("")
    assert not keys.is_proof("\udce4")
    assert proof not in repr(keys)
