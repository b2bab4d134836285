"""What the one-shot service `secrets` makes of the files that a site has, and of none."""

from __future__ import annotations

import json
import subprocess
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from dated_certificate import make_certificate
from image_names import ensure_built, image

FOLDERS: dict[str, set[str]] = {
    "mysql": {
        "mysql_web_password",
        "mysql_relay_password",
        "mysql_keylookup_password",
        "mysql_migrate_password",
    },
    "migrate": {"mysql_migrate_password"},
    "web": {"mysql_web_password", "ticket_key", "web_secret_key", "admin_password"},
    "relay": {"mysql_relay_password", "ticket_key", "session_key"},
    "sshd": {"mysql_keylookup_password", "session_key"},
    "demo": {"mysql_web_password"},
    "nginx": set(),
}


# Prints the volume: folder, then file, then owner, mode and text.
LOOK = """
import json, pathlib
print(json.dumps({
    folder.name: {
        file.name: [file.stat().st_uid, file.stat().st_mode & 0o777, file.read_text()]
        for file in folder.iterdir()
    }
    for folder in pathlib.Path("/secrets").iterdir()
}))
"""


@pytest.fixture(scope="module", autouse=True)
def built() -> None:
    """The image, as it is in this checkout."""
    ensure_built("server")


@dataclass(frozen=True)
class Site:
    """A volume, and a folder of secrets of one's own, which nobody else may enter."""

    volume: str
    own: Path

    def make(self, cert: object = "", key: object = "") -> tuple[int, str]:
        """Run the service as compose does; status and what it printed."""
        done = self._run(
            "make-secrets",
            f"{self.own}:/own/secrets:ro",
            f"{cert or '/dev/null'}:/own/cert.pem:ro",
            f"{key or '/dev/null'}:/own/key.pem:ro",
        )
        return done.returncode, done.stdout + done.stderr

    def files(self) -> dict[str, dict[str, list[Any]]]:
        """What is in the volume: folder -> name -> owner, mode, text."""
        found: dict[str, dict[str, list[Any]]] = json.loads(self._run("python3", "").stdout)
        return found

    def texts(self) -> dict[str, dict[str, str]]:
        """What each service finds: folder -> name -> text."""
        return {
            folder: {name: text for name, (_, _, text) in files.items()}
            for folder, files in self.files().items()
            if folder in FOLDERS
        }

    def _run(self, command: str, *mounts: str) -> subprocess.CompletedProcess[str]:
        given = ["docker", "run", "--interactive", "--rm", "--read-only", "--network", "none"]
        given += [
            "--user",
            "0:0",
            "--cap-drop",
            "ALL",
            "--cap-add",
            "CHOWN",
            "--cap-add",
            "DAC_OVERRIDE",
        ]
        for mount in (f"{self.volume}:/secrets", *filter(None, mounts)):
            given += ["--volume", mount]
        return subprocess.run(
            [*given, image("server"), command],
            input=LOOK,
            check=False,
            capture_output=True,
            text=True,
            timeout=60,
        )


@contextmanager
def site_in(folder: Path) -> Iterator[Site]:
    """Nothing made yet."""
    own = folder / "own"
    own.mkdir(mode=0o700)
    volume = f"robotether-test-secrets-{uuid.uuid4().hex[:8]}"
    yield Site(volume, own)
    subprocess.run(["docker", "volume", "rm", volume], check=True, capture_output=True)


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    """A site that was never started."""
    with site_in(tmp_path) as made:
        yield made


def test_each_service_gets_its_own_secrets(site: Site) -> None:
    """Long ones, the same for those that share one, readable by one account; nothing of them is printed."""
    status, said = site.make()
    assert status == 0, said
    files = site.files()
    made = files.pop("made")
    assert {folder: set(found) for folder, found in files.items()} == FOLDERS
    assert files["web"].pop("admin_password")[2] == ""
    assert len({text for _, _, text in made.values()}) == len(made)
    for found in files.values():
        for name, (owner, mode, text) in found.items():
            assert text == made[name][2]
            assert len(text) > 40
            assert text not in said
            assert (owner != 0, mode) == (True, 0o440)
    assert {mode for _, mode, _ in made.values()} == {0o600}
    owners = {owner for owner, _, _ in files["sshd"].values()}
    assert len(owners) == len(files["sshd"])


def test_later_starts_keep_them(site: Site) -> None:
    """And print nothing."""
    site.make()
    before = site.files()
    assert site.make() == (0, "")
    assert site.files() == before


def test_files_of_ones_own_win(site: Site) -> None:
    """As a site has them from before; what is missing or empty among them is made."""
    site.make()
    for name, text in (
        ("ticket_key", "t" * 40),
        ("admin_password", "one of ones own"),
        ("session_key", ""),
    ):
        (site.own / name).write_text(text)
        (site.own / name).chmod(0o600)
    assert site.make() == (0, "")
    texts = site.texts()
    assert texts["web"]["ticket_key"] == texts["relay"]["ticket_key"] == "t" * 40
    assert texts["web"]["admin_password"] == "one of ones own"
    assert len(texts["relay"]["session_key"]) > 40


def make_pair(folder: Path, name: str, *, days: int = 2) -> tuple[Path, Path]:
    """A self-signed certificate that began nine days ago and ends in so many, and its key."""
    now = datetime.now(UTC)
    both = make_certificate(folder, now - timedelta(days=9), now + timedelta(days=days))
    cert, key = folder / f"{name}.crt", folder / f"{name}.key"
    begin_of_key = "-----BEGIN PRIVATE KEY-----"
    certificate, _, private = both.read_text().partition(begin_of_key)
    cert.write_text(certificate)
    key.write_text(begin_of_key + private)
    key.chmod(0o600)
    return cert, key


def test_own_certificate_is_handed_to_nginx_and_taken_back(site: Site, tmp_path: Path) -> None:
    """It is copied when both settings name a pair, and removed when they are empty again."""
    cert, key = make_pair(tmp_path, "robots.example.org")
    assert site.make(cert, key)[0] == 0
    files = site.files()["nginx"]
    assert {name: found[2] for name, found in files.items()} == {
        "cert.pem": cert.read_text(),
        "key.pem": key.read_text(),
    }
    assert files["key.pem"][1] == 0o440
    assert site.make() == (0, "")
    assert site.texts()["nginx"] == {}


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pairs, one that has ended, and a folder."""
    folder = tmp_path_factory.mktemp("certificates")
    (folder / "own").mkdir()
    make_pair(folder, "one")
    make_pair(folder, "two")
    make_pair(folder, "ended", days=-1)
    return folder


@pytest.fixture(scope="module")
def serving(certificates: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A site with a certificate of its own, which no test changes."""
    with site_in(tmp_path_factory.mktemp("serving")) as made:
        assert made.make(certificates / "one.crt", certificates / "one.key")[0] == 0
        yield made


@pytest.mark.parametrize(
    ("pair", "why"),
    [
        (("one.crt", ""), "set both"),
        (("", "one.key"), "set both"),
        (("one.crt", "two.key"), "is not the key of"),
        (("one.crt", "own"), "is not the key of"),
        (("one.key", "one.key"), "is no certificate"),
        (("ended.crt", "ended.key"), "has ended"),
    ],
)
def test_own_certificate_that_cannot_serve_stops_the_start(
    serving: Site, certificates: Path, pair: tuple[str, str], why: str
) -> None:
    """With a sentence; what serves goes on."""
    status, said = serving.make(*(name and certificates / name for name in pair))
    assert status == 1
    assert "cannot use your own certificate: " in said
    assert why in said
    good = (certificates / "one.crt").read_text()
    assert serving.texts()["nginx"]["cert.pem"] == good
