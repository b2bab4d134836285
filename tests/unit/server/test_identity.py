"""MACs in every usual spelling (the twin in SQL is compared in db/test_robots.py), and OpenSSH public keys."""

import base64
import struct
import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st
from openssh_server import make_key
from robot_signer import RobotSigner
from robotether_server.identity import (
    check_universal_mac,
    key_comment,
    normalise_mac,
    parse_persons_key,
    parse_robots_key,
)
from robotether_server.problems import FieldInvalidError

# The generator of the curve, which is a point of it.
NISTP256_POINT = bytes.fromhex(
    "046b17d1f2e12c4247f8bce6e563a440f277037d812deb33a0f4a13945d898c296"
    "4fe342e2fe1a7f9b8ee7eb4a7c0f9e162bce33576b315ececbb6406837bf51f5"
)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("00:1b-44:11:3a:b7", "write it as 00:1b:44:11:3a:b7"),
        ("001b44113ab7\n", "write it as"),
        ("\N{FULLWIDTH DIGIT ZERO}01b44113ab7", "write it as"),
        ("0:0:0:0:0:0", "which no single robot has"),
        ("ffff.ffff.ffff", "which no single robot has"),
        ("330000000001", "which no single robot has"),
    ],
)
def test_what_is_no_mac_of_a_robot_is_refused(text, why):
    with pytest.raises(FieldInvalidError, match=f"cannot use mac .* {why}"):
        normalise_mac(text)


@pytest.mark.parametrize("text", ["2:42:ac:11:0:2", "fe0000000001"])
def test_macs_that_machines_give_themselves_are_refused_unless_allowed(text):
    with pytest.raises(FieldInvalidError, match=r"locally administered.*--allow-local-mac"):
        normalise_mac(text, allow_local=False)
    with pytest.raises(FieldInvalidError, match="locally administered"):
        check_universal_mac(normalise_mac(text))


def fingerprint_of(file):
    """What ssh-keygen prints."""
    done = subprocess.run(["ssh-keygen", "-lf", file], check=True, capture_output=True, text=True)
    return done.stdout.split()[1]


@pytest.mark.parametrize(
    ("kind", "bits"), [("ed25519", 0), ("ecdsa", 256), ("ecdsa", 521), ("rsa", 3072)]
)
def test_fingerprint_is_that_of_ssh_keygen(tmp_path, kind, bits):
    """What sshd passes to the lookup is what stands in the row; the comment is gone."""
    line = make_key(tmp_path / "key", kind=kind, bits=bits, comment="a comment")
    key = parse_persons_key(line)
    assert key.fingerprint == fingerprint_of(tmp_path / "key.pub")
    assert key.line == " ".join(line.split()[:2])
    assert parse_robots_key(f"{line.replace(' ', '  ')}\n") == key, "robots may have it too"
    assert key_comment(line) == "a comment"


def wire(*fields):
    return base64.b64encode(b"".join(struct.pack(">I", len(f)) + f for f in fields)).decode()


def test_keys_of_security_keys_are_peoples(tmp_path):
    for kind, *fields in (
        (b"sk-ssh-ed25519@openssh.com", b"p" * 32, b"ssh:"),
        (b"sk-ecdsa-sha2-nistp256@openssh.com", b"nistp256", NISTP256_POINT, b"ssh:"),
    ):
        line = f"{kind.decode()} {wire(kind, *fields)} ann@desk"
        file = tmp_path / "sk.pub"
        file.write_text(line)
        assert parse_persons_key(line).fingerprint == fingerprint_of(file)
        with pytest.raises(FieldInvalidError):
            parse_robots_key(line)
        with pytest.raises(FieldInvalidError, match="damaged"):
            parse_persons_key(f"{kind.decode()} {wire(kind, *fields[:-1])}")


def test_short_rsa_key_is_refused(tmp_path):
    parse_persons_key(make_key(tmp_path / "key", kind="rsa", bits=2048))
    with pytest.raises(FieldInvalidError, match="2048 bits or more, this has 1024"):
        parse_persons_key(f"ssh-rsa {wire(b'ssh-rsa', b'!', bytes(1) + bytes([255]) * 128)}")


@pytest.mark.parametrize(
    "change",
    [
        lambda line: line.split()[1],
        lambda line: 'command="sh" ' + line,
        lambda line: line + "\n" + line,
        lambda line: line.replace(" ", "\n", 1),
        lambda line: line + " \x1b[2J",
        lambda line: line.replace("ssh-ed25519", "ssh-rsa"),
        lambda line: line.replace("ssh-ed25519", "ssh-dss"),
        lambda line: line.split()[0] + " " + line.split()[1][:-8],
        lambda line: line.split()[0] + " " + line.split()[1] + "AAAA",
        lambda line: line.split()[0] + " !" + line.split()[1],
        lambda line: line + " " + "x" * 3000,
    ],
)
def test_what_is_no_plain_key_is_refused(change):
    """Options, a second line, control characters, damage and other types do not reach sshd."""
    for read in (parse_robots_key, parse_persons_key):
        with pytest.raises(FieldInvalidError, match="cannot use public_key"):
            read(change(f"{RobotSigner(1).line} a comment"))


@given(
    st.sampled_from(["ssh-ed25519", "ssh-rsa", "ecdsa-sha2-nistp256"]),
    st.lists(st.just(b"nistp256") | st.binary(max_size=31), max_size=4),
)
def test_rubbish_is_refused_with_a_problem(kind, fields):
    """A stranger's key may have anything in the place of a point or a number."""
    with pytest.raises(FieldInvalidError):
        parse_persons_key(f"{kind} {wire(kind.encode(), *fields)}")
