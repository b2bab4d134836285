"""OpenSSH public keys: fingerprints as ssh-keygen prints them, and nothing but a key gets through."""

from __future__ import annotations

import base64
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_server.problems import FieldInvalid
from robotether_server.ssh_keys import parse


def make_key(folder: Path, kind: str, bits: int) -> tuple[str, str]:
    """A real key line and its fingerprint."""
    file = folder / "key"
    size = ["-b", str(bits)] if bits else []
    subprocess.run(
        ["ssh-keygen", "-q", "-t", kind, *size, "-N", "", "-C", "a comment", "-f", file], check=True
    )
    shown = subprocess.run(
        ["ssh-keygen", "-lf", file.with_suffix(".pub")], check=True, capture_output=True, text=True
    )
    return file.with_suffix(".pub").read_text(), shown.stdout.split()[1]


@pytest.fixture(scope="module")
def ed25519(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A real key line."""
    return make_key(tmp_path_factory.mktemp("key"), "ed25519", 0)[0].strip()


@pytest.mark.parametrize(
    ("kind", "bits"), [("ed25519", 0), ("ecdsa", 256), ("ecdsa", 521), ("rsa", 3072)]
)
def test_fingerprint_is_that_of_ssh_keygen(tmp_path: Path, kind: str, bits: int) -> None:
    """What sshd passes to the lookup is what stands in the row; the comment is gone."""
    line, fingerprint = make_key(tmp_path, kind, bits)
    key = parse(line.strip())
    assert key.fingerprint == fingerprint
    assert key.line == " ".join(line.split()[:2])


def test_short_rsa_key_is_refused(tmp_path: Path) -> None:
    """The sentence says how many bits it needs."""
    with pytest.raises(FieldInvalid, match="3072 bits or more, this has 2048"):
        parse(make_key(tmp_path, "rsa", 2048)[0].strip())


@pytest.mark.parametrize(
    "change",
    [
        lambda line: "",
        lambda line: line.split()[1],
        lambda line: "restrict " + line,
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
def test_what_is_no_plain_key_is_refused(ed25519: str, change: object) -> None:
    """Options, a second line, control characters, damage and other types do not reach sshd."""
    assert callable(change)
    with pytest.raises(FieldInvalid, match="cannot use public_key"):
        parse(change(ed25519))


@given(st.binary(max_size=120), st.sampled_from(["ssh-ed25519", "ssh-rsa", "ecdsa-sha2-nistp256"]))
def test_rubbish_is_refused_with_a_problem(blob: bytes, kind: str) -> None:
    """No bytes from outside raise anything else."""
    with pytest.raises(FieldInvalid):
        parse(f"{kind} {base64.b64encode(blob).decode()}")
