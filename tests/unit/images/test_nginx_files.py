"""What nginx's configurations say of the containers' own bounds; tests/images asks nginx itself."""

import re
from pathlib import Path

import pytest

IMAGES = Path(__file__).resolve().parents[3] / "images"
# Memory of an idle TLS connection, measured with 11,880 of them.
TLS_CONNECTION_KIB = 46
# Memory of the beginning of a request.
FIRST_HEADERS_KIB = 1
# Memory of a request for the largest document, compressed for who does not read, with its file in memory.
SLOW_READER_KIB = 870


@pytest.mark.parametrize(
    ("configuration", "script"),
    [
        ("nginx/nginx.conf", "nginx/open-files.sh"),
        ("nginx/direct.conf", "nginx/open-files.sh"),
        ("sshd/proxy-protocol.conf", "sshd/entrypoint.sh"),
    ],
)
def test_worker_may_open_what_its_connections_need(configuration, script):
    """A container begins with 1024 open files where Docker is 29 or newer."""
    connections = re.findall(r"worker_connections (\d+);", (IMAGES / configuration).read_text())
    files = re.findall(r"OPEN_FILES=(\d+)\n", (IMAGES / script).read_text())
    assert int(*files) >= 2 * int(*connections)


def test_a_stop_begins_here_when_the_robots_cell_cannot_answer():
    """Also when that says so itself: it has nobody to ask who a login is while the database is away."""
    text = (IMAGES / "nginx" / "peer-forward.conf").read_text()
    [stop] = re.findall(r"location @cell_or_here \{([^}]*)\}", text)
    assert "error_page 502 503 504 = @here;" in stop
    assert "proxy_intercept_errors on;" in stop


@pytest.mark.parametrize("name", ["nginx.conf", "peer-forward.conf", "peer-server.conf"])
def test_no_ticket_is_logged_while_the_relay_is_away(name):
    """Each request to the relay may have one in its query, which nginx's error lines hold."""
    locations = re.findall(r"location [^{]*\{([^}]*)\}", (IMAGES / "nginx" / name).read_text())
    to_relay = [body for body in locations if "proxy_pass http://$relay" in body]
    assert to_relay
    assert all("error_log stderr crit;" in body for body in to_relay)


def test_every_request_counts_for_its_address():
    """What a stranger may ask of relay or web is bounded, and a stop's bound is not used up by anything else."""
    text = (IMAGES / "nginx" / "nginx.conf").read_text()
    https = text[text.index("listen unix:/run/nginx/tls.sock") :]
    locations = re.findall(
        r"location ([^{]*\S) \{([^}]*)\}", re.sub(r'"[^"]*"', _without_braces, https)
    )
    bounds = {
        name: set(re.findall(r"limit_(?:req|conn) (?:zone=)?(\w+)", body))
        for name, body in locations
        if "proxy_pass" in body and "internal;" not in body
    }
    zones_of_addresses = {
        zone
        for key, zone in re.findall(r"limit_(?:req|conn)_zone (\S+) zone=(\w+)", text)
        if key in {"$binary_remote_addr", "$asks_without_ticket"}
    }
    assert [name for name, zones in bounds.items() if not zones & zones_of_addresses] == []
    of_stops = [name for name, zones in bounds.items() if "stop" in zones]
    assert of_stops == ['~ "^/api/v1/(stop|robots/[^/]+/stop)$"']
    assert bounds[of_stops[0]] == {"stop"}


def test_files_for_slow_readers_fit_in_the_containers_memory():
    """A request holds its file and a compressor: a few connections of HTTP/2 have hundreds."""
    text = (IMAGES / "nginx" / "nginx.conf").read_text()
    most = {zone: int(number) for zone, number in re.findall(r"limit_conn (\w+) (\d+);", text)}
    assert most["files"] * SLOW_READER_KIB / 1024 < 0.6 * _memory_mib()
    assert most["files_of_address"] < most["files"] / 2


def test_every_port_bounds_the_connections_of_an_address():
    """Before a request is there: one that never comes holds a place of all that nginx has."""
    text = (IMAGES / "nginx" / "nginx.conf").read_text()
    stream, http = text[: text.index("http {")], text[text.index("http {") :]
    assert re.findall(r"listen (\S+?)[ ;]", http) == [
        "unix:/run/nginx/http.sock",
        "unix:/run/nginx/tls.sock",
    ]
    servers = re.findall(r"    server \{\n(.*?)\n    \}", stream, re.DOTALL)
    public = [body for body in servers if "listen 127.0.0.1" not in body]
    assert len(public) == 2
    assert all("limit_conn " in body for body in public)


def _without_braces(quoted):
    return re.sub(r"[{}]", "", quoted[0])


def test_connections_of_strangers_fit_in_the_containers_memory():
    """Headers may be large and never end: nginx closes only idle connections. More cores bring no more of them."""
    text = (IMAGES / "nginx" / "nginx.conf").read_text()
    said = dict(re.findall(r"(worker_\w+) +(\w+);", text))
    most = int(said["worker_processes"]) * int(said["worker_connections"])
    buffers, size_kib = map(int, *re.findall(r"large_client_header_buffers (\d+) (\d+)k;", text))
    each_kib = TLS_CONNECTION_KIB + FIRST_HEADERS_KIB + buffers * size_kib
    assert most * each_kib / 1024 < 0.8 * _memory_mib()


def _memory_mib():
    compose = (IMAGES.parent / "compose" / "compose.yaml").read_text()
    [memory_mib] = re.findall(r"\n  nginx:\n(?:(?:    .*)?\n)*?    mem_limit: (\d+)m\n", compose)
    return int(memory_mib)
