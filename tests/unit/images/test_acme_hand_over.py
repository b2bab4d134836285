"""How the acme container hands a certificate to nginx, and what it and Alertmanager do of a wrong setting.

Programs are in the place of lego, a full disk and a sleep without end.
"""

import os
import subprocess
from pathlib import Path

import pytest
from tls_front import openssl

IMAGES = Path(__file__).resolve().parents[3] / "images"
ENTRYPOINT = IMAGES / "acme" / "entrypoint.sh"
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
    openssl(
        *("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"),
        *("-days", "2", "-subj", f"/CN={DOMAIN}"),
        *("-keyout", str(certificates / f"{DOMAIN}.key")),
        *("-out", str(certificates / f"{DOMAIN}.crt")),
    )
    (out / "pair-1").mkdir(parents=True)
    (out / "pair-1" / "cert.pem").write_text("the old one")
    (out / "current").symlink_to("pair-1")
    # The wait for the next try ends the program; that of 5 s is between two signs of life.
    sleep = '#!/bin/sh\n[ "$1" = 5 ] || kill $PPID\n'
    programs = {"lego": "#!/bin/sh\n", "cp": FULL_DISK, "sleep": sleep}
    (tmp_path / "bin").mkdir()
    for name, text in programs.items():
        (tmp_path / "bin" / name).write_text(text)
        (tmp_path / "bin" / name).chmod(0o755)
    entrypoint = tmp_path / "entrypoint.sh"
    entrypoint.write_text(
        ENTRYPOINT.read_text()
        .replace("=/var/lib/acme\n", f"={state}\n")
        .replace("=/etc/nginx/acme\n", f"={out}\n")
        .replace("=/tmp/alive\n", f"={tmp_path / 'alive'}\n")
    )
    environ = {
        **os.environ,
        "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}",
        "DOMAIN": DOMAIN,
        "ACME_EMAIL": "ops@example.org",
        "ACME_SERVER": "https://acme.example.org/directory",
    }
    done = subprocess.run(
        ["sh", entrypoint], env=environ, check=False, capture_output=True, text=True, timeout=30
    )
    assert "No space left" in done.stderr
    assert (out / "current" / "cert.pem").read_text() == "the old one"
    assert sorted(path.name for path in out.iterdir()) == ["current", "pair-1"]


@pytest.mark.parametrize(
    ("program", "setting", "why"),
    [
        (ENTRYPOINT, {"DOMAIN": "Robots"}, "DOMAIN is 'Robots'; allowed is"),
        (IMAGES / "prometheus" / "alertmanager", {"ALERT_EMAIL_TO": "a@b.example"}, "ALERT_SMTP is not"),
    ],
)  # fmt: skip
def test_wrong_setting_waits_for_a_person(tmp_path, program, setting, why):
    """Docker would start what ends again and again, with the same line each time."""
    sleep = tmp_path / "sleep"
    sleep.write_text('#!/bin/sh\necho "sleeps $1"\n')
    sleep.chmod(0o755)
    environ = {**os.environ, **setting, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(["sh", program], env=environ, check=False, capture_output=True, text=True)
    assert why in done.stderr
    assert done.stdout == "sleeps infinity\n"
