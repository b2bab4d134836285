"""Signatures in OpenSSH's format: `ssh-keygen -Y` reads ours, and we read its own."""

import base64
import struct
import subprocess

import pytest
from openssh_server import make_key
from robotether_server.signatures import SigningKey, is_signed, key_of

NAMESPACE = "robotether-rotation"
MESSAGE = "00:1b:44:11:3a:b7 ssh-ed25519 AAAA\n"
SERVER = SigningKey("x" * 32, "a test")


def ssh_keygen(*words, message=""):
    return subprocess.run(
        ["ssh-keygen", *map(str, words)], input=message.encode(), check=True, capture_output=True
    ).stdout.decode()


def key_in(file, kind, bits):
    """Make a key; return its public half."""
    return " ".join(make_key(file, kind=kind, bits=bits).split()[:2])


def sign(file, namespace, message, *options):
    return ssh_keygen("-Y", "sign", "-f", file, "-n", namespace, *options, message=message)


@pytest.mark.parametrize(
    ("kind", "bits"),
    [("ed25519", 0), ("ecdsa", 256), ("ecdsa", 384), ("ecdsa", 521), ("rsa", 2048)],
)
def test_only_the_keys_own_signature_over_the_message_holds(tmp_path, kind, bits):
    own, foreign = tmp_path / "own", tmp_path / "foreign"
    key, other = key_in(own, kind, bits), key_in(foreign, kind, bits)
    good = sign(own, NAMESPACE, MESSAGE)
    assert key_of(good) == key
    for signature in (good, sign(own, NAMESPACE, MESSAGE, "-O", "hashalg=sha256")):
        assert is_signed(key, NAMESPACE, MESSAGE, signature)
        assert not is_signed(other, NAMESPACE, MESSAGE, signature)
    lines = good.splitlines()
    for wrong in (
        sign(own, NAMESPACE, MESSAGE.strip()),
        sign(own, "file", MESSAGE),
        sign(foreign, NAMESPACE, MESSAGE),
        good.replace("A", "B"),
        "\n".join((*lines[:-3], lines[-3].swapcase(), *lines[-2:])),
        "\n".join((*lines[:-2], lines[-1])),
        SERVER.sign(NAMESPACE, MESSAGE),
    ):
        assert not is_signed(key, NAMESPACE, MESSAGE, wrong)


@pytest.mark.parametrize("signature", ["", "x", "\N{SNOWMAN}", "-----BEGIN SSH SIGNATURE-----\n\n"])
def test_damaged_signature_is_none(signature):
    assert not is_signed(SERVER.public_key, "a", "b", signature)
    assert key_of(signature) is None


def test_a_key_whose_point_is_none_has_signed_nothing():
    """Somebody may write it into the audit log, whose check must go on."""
    own = base64.b64decode(SERVER.public_key.split()[1])
    other = b"".join(map(field, (b"ecdsa-sha2-nistp256", b"nistp256", b"\0")))
    begin, *lines, end = SERVER.sign("a", "b").splitlines()
    blob = base64.b64decode("".join(lines)).replace(field(own), field(other))
    signature = "\n".join((begin, base64.b64encode(blob).decode(), end))
    assert not is_signed(key_of(signature), "a", "b", signature)


def field(content):
    return struct.pack(">I", len(content)) + content


def test_openssh_verifies_what_the_server_signs(tmp_path):
    signers, file = tmp_path / "signers", tmp_path / "signature"
    signers.write_text(f"server {SERVER.public_key}\n")
    file.write_text(SERVER.sign("a", "b"))
    verify = ("-Y", "verify", "-f", signers, "-I", "server", "-n", "a", "-s", file)
    ssh_keygen(*verify, message="b")
    with pytest.raises(subprocess.CalledProcessError):
        ssh_keygen(*verify, message="c")
