"""known_hosts files, compared with what OpenSSH itself reads in them."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from robotether_server.cli.fleet import known_hosts
from robotether_server.cli.fleet.known_hosts import KnownKey
from robotether_server.cli.fleet.problems import ConfigUnusable
from shell_hosts import make_key

NAMES = ("robotether-sim1", "robotether-sim2", "[gate.example]:2222", "gate.example", "10.0.0.7")


@pytest.fixture
def key(tmp_path: Path) -> KnownKey:
    kind, encoded = make_key(tmp_path / "host").split()[:2]
    return KnownKey(kind, encoded)


def openssh_finds(path: Path, name: str) -> bool:
    command = ["ssh-keygen", "-F", name, "-f", str(path)]
    return subprocess.run(command, check=False, capture_output=True).returncode == 0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "hosts", [*NAMES, "*", "robotether-*,!robotether-sim2", "10.0.0.?", "a,*:2222"]
)
def test_names_fit_as_in_openssh(tmp_path: Path, key: KnownKey, hosts: str, name: str) -> None:
    """Patterns, negation, brackets, lists."""
    path = tmp_path / "known_hosts"
    path.write_text(f"{hosts} {key.type} {key.encoded} a comment\n")
    found = key in known_hosts.find([path], name).trusted
    assert found == openssh_finds(path, name)


@pytest.mark.parametrize("name", NAMES)
def test_hashed_names_fit(tmp_path: Path, key: KnownKey, name: str) -> None:
    """As `HashKnownHosts yes` writes them."""
    path = tmp_path / "known_hosts"
    path.write_text(f"{name} {key.type} {key.encoded}\n")
    subprocess.run(["ssh-keygen", "-q", "-H", "-f", str(path)], check=True, capture_output=True)
    assert path.read_text().startswith("|1|")
    assert [one for one in NAMES if known_hosts.find([path], one).trusted] == [name]


def test_markers_are_no_trust(tmp_path: Path, key: KnownKey) -> None:
    """A revoked key is known as such; an authority's is no host's."""
    path = tmp_path / "known_hosts"
    path.write_text(
        f"@revoked * {key.type} {key.encoded}\n@cert-authority * {key.type} {key.encoded}\n"
    )
    known = known_hosts.find([path], "sim1")
    assert (known.trusted, known.revoked) == (frozenset(), frozenset({key}))


def test_rubbish_is_passed_over(tmp_path: Path, key: KnownKey) -> None:
    """Comments, half lines, broken hashes and bytes that are no text."""
    path = tmp_path / "known_hosts"
    path.write_bytes(
        b"# sim1 x y\n\nsim1 half\n|1|%%%|x a b\n|1|x a b\n\xff\xfe sim1\n@revoked\n"
        + f"sim1 {key.type} {key.encoded}\n".encode()
    )
    assert known_hosts.find([path, tmp_path / "missing"], "sim1").trusted == {key}


def test_added_key_is_found_by_openssh(tmp_path: Path, key: KnownKey) -> None:
    """On a line of its own, in a file that only its owner reads."""
    path = tmp_path / "new" / "known_hosts"
    known_hosts.add(path, "robotether-sim1", key)
    assert path.stat().st_mode & 0o777 == 0o600
    path.write_text(path.read_text().rstrip("\n"))
    known_hosts.add(path, "[gate.example]:2222", key)
    for name in ("robotether-sim1", "[gate.example]:2222"):
        assert openssh_finds(path, name)
        assert known_hosts.find([path], name).trusted == {key}


def test_file_that_cannot_be_used_is_told(tmp_path: Path, key: KnownKey) -> None:
    """A folder in its place, say."""
    with pytest.raises(ConfigUnusable, match="cannot read the known host keys"):
        known_hosts.find([tmp_path], "sim1")
    with pytest.raises(ConfigUnusable, match="cannot save the key of sim1"):
        known_hosts.add(tmp_path, "sim1", key)
