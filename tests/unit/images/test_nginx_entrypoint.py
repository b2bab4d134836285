"""What nginx's entrypoint does before nginx, with a program in its place; tests/images asks nginx itself."""

from pathlib import Path

import pytest
from commands import path_with, run_command, write_programs

NGINX = Path(__file__).resolve().parents[3] / "images" / "nginx"


def start(place, port):
    """Run the entrypoint with its folders in `place`, up to its check of what it has written."""
    for name in ("entrypoint.sh", "certificates.sh", "networks.sh", "open-files.sh"):
        text = (NGINX / name).read_text()
        for folder in ("/run/nginx", "/etc/nginx", "/usr/lib/robotether"):
            text = text.replace(folder, f"{place}{folder}")
            (place / folder[1:]).mkdir(parents=True, exist_ok=True)
        (place / "usr/lib/robotether" / name).write_text(text)
    (place / "etc/nginx/tls").mkdir(exist_ok=True)
    write_programs(place, {"nginx": "exit 9"})
    environ = {**path_with(place), "PUBLIC_PORT": port}
    return run_command("sh", place / "usr/lib/robotether/entrypoint.sh", env=environ)


@pytest.mark.parametrize(("port", "suffix"), [("", ""), ("443", ""), ("8443", ":8443")])
def test_redirect_leads_to_the_port_of_https(tmp_path, port, suffix):
    """A browser that was sent to 443 would find nothing, or another server."""
    assert start(tmp_path, port).returncode == 9
    written = (tmp_path / "run/nginx/https-port.conf").read_text()
    assert written == f'set $https_port "{suffix}";\n'
    assert "return 308 https://$host$https_port$request_uri;" in (NGINX / "nginx.conf").read_text()


def test_port_that_is_none_stops_the_start(tmp_path):
    """It would become a part of nginx's configuration."""
    done = start(tmp_path, '1";')
    assert done.returncode == 1
    assert "PUBLIC_PORT is '1\";'" in done.stderr
