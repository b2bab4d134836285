"""How the acme container hands a certificate to nginx, with programs in the place of lego and of a full disk."""

import os
from pathlib import Path

from commands import path_with, run_command, write_programs
from tls_front import make_pair

ENTRYPOINT = Path(__file__).resolve().parents[3] / "images" / "acme" / "entrypoint.sh"
DOMAIN = "robots.example.org"
FULL_DISK = """#!/bin/sh
head -c 20 "$1" > "$2"
echo 'cp: No space left on device' >&2
exit 1
"""


def test_full_disk_leaves_nginx_the_old_certificate(tmp_path):
    """Half a pair would serve nothing: after its next start nginx had only the self-signed one."""
    state, out = tmp_path / "state", tmp_path / "out"
    certificates = state / "certificates"
    certificates.mkdir(parents=True)
    make_pair(certificates / f"{DOMAIN}.crt", certificates / f"{DOMAIN}.key", DOMAIN)
    (out / "pair-1").mkdir(parents=True)
    (out / "pair-1" / "cert.pem").write_text("the old one")
    (out / "current").symlink_to("pair-1")
    # The wait for the next try ends the program; that of 5 s is between two signs of life.
    sleep = '[ "$1" = 5 ] || kill $PPID'
    write_programs(tmp_path / "bin", {"lego": "", "cp": FULL_DISK, "sleep": sleep})
    entrypoint = tmp_path / "entrypoint.sh"
    entrypoint.write_text(
        ENTRYPOINT.read_text()
        .replace("=/var/lib/acme\n", f"={state}\n")
        .replace("=/etc/nginx/acme\n", f"={out}\n")
        .replace("=/tmp/alive\n", f"={tmp_path / 'alive'}\n")
    )
    environ = {
        **os.environ,
        **path_with(tmp_path / "bin"),
        "DOMAIN": DOMAIN,
        "ACME_EMAIL": "ops@example.org",
        "ACME_SERVER": "https://acme.example.org/directory",
    }
    assert "No space left" in run_command("sh", entrypoint, env=environ).stderr
    assert (out / "current" / "cert.pem").read_text() == "the old one"
    assert sorted(path.name for path in out.iterdir()) == ["current", "pair-1"]
