"""The files of docs/howto/reverse-proxy.md as readers have them, each in front of our nginx alone."""

import http.client
import json
import re
import socket
from contextlib import closing, contextmanager
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path

import pytest
from commands import output_of_command
from image_names import ensure_built, image
from inside import run_inside
from local_network import insecure_tls
from nginx_alone import Containers, address_in
from openssh_server import wait_until
from tls_front import make_pair

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "howto" / "reverse-proxy.md"
HOST, BEHIND = "robots.example.org", "stack.example.org"
STRANGERS_CLAIM = "203.0.113.9"
# In the place of web and relay: says who asks whom, sends the second half of a stream once `more` is asked for, and
# accepts an upgrade.
PARTS = """
import json, threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

more = threading.Event()

class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self):
        if self.path.endswith("/ros"):
            self.send_response(101)
            self.send_header("Upgrade", self.headers["Upgrade"])
            self.send_header("Connection", "upgrade")
            self.end_headers()
            self.wfile.write(b"through")
            self.close_connection = True
            return
        self.send_response(200)
        if self.path.endswith("/video/stream"):
            self.send_header("Content-Length", "10")
            self.end_headers()
            self.wfile.write(b"first")
            more.wait()
            self.wfile.write(b"again")
            return
        if self.path == "/more":
            more.set()
        sent = json.dumps([self.headers["X-Forwarded-For"], self.headers["Host"]]).encode()
        self.send_header("Content-Length", str(len(sent)))
        self.end_headers()
        self.wfile.write(sent)

threading.Thread(target=ThreadingHTTPServer(("", 8080), Handler).serve_forever).start()
ThreadingHTTPServer(("", 8000), Handler).serve_forever()
"""


def of_page(language):
    [file] = re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return str(file)


@dataclass
class Site:
    """Our nginx on a network with the proxy and the parts, and on one with people."""

    folder: Path
    containers: Containers

    def __post_init__(self):
        self.people, self.inside = self.containers.network(), self.containers.network()
        [config] = self.inside.attrs["IPAM"]["Config"]
        self.stack = self.containers.start(
            self.inside, image("nginx"), BEHIND,
            environment={"PUBLIC_HOST": HOST, "TRUSTED_PROXIES": config["Subnet"]},
        )  # fmt: skip
        self.people.connect(self.stack)
        self.containers.start(
            self.inside, image("server"), "web", "relay", command=["python3", "-c", PARTS]
        )
        healthy = "/usr/lib/robotether/healthy"
        wait_until(lambda: run_inside(self.stack, healthy).returncode == 0, self.stack.logs)
        shown = run_inside(self.stack, "cat", "/etc/nginx/tls/cert.pem").stdout
        (self.folder / "robotether.pem").write_text(shown)

    @property
    def visitor(self):
        [config] = self.people.attrs["IPAM"]["Config"]
        return str(config["Gateway"])

    def address(self, container):
        return address_in(self.people, container)

    def file(self, name, text):
        made = self.folder / name
        made.write_text(text)
        return made

    def start_nginx(self):
        make_pair(self.folder / "cert", self.folder / "key", HOST)
        (self.folder / "key").chmod(0o444)
        frame = "user www-data; pid /run/nginx/pid; error_log stderr; events {} http { include /site.conf; }"
        return self.proxy(
            image("nginx"),
            {
                self.file("frame.conf", frame): "/frame.conf",
                self.file("site.conf", of_page("nginx")): "/site.conf",
                self.folder / "cert": f"/etc/nginx/{HOST}.pem",
                self.folder / "key": f"/etc/nginx/{HOST}.key",
                self.folder / "robotether.pem": "/etc/nginx/robotether.pem",
            },
            entrypoint=["nginx", "-c", "/frame.conf", "-g", "daemon off;"],
            user="0:0",
        )

    def start_caddy(self):
        """The page's Caddy, with a certificate of its own authority as there is no public one here."""
        recipe = "FROM debian:trixie-slim\nRUN apt-get update && apt-get install -y --no-install-recommends caddy\n"
        build = ("docker", "build", "--quiet", "--tag", "local.invalid/robotether/caddy_test", "-")
        output_of_command(*build, input=recipe, limit_s=600)
        text = "{\n    local_certs\n    skip_install_trust\n}\n" + of_page("caddyfile")
        return self.proxy(
            "local.invalid/robotether/caddy_test",
            {
                self.file("Caddyfile", text): "/etc/caddy/Caddyfile",
                self.folder / "robotether.pem": "/etc/caddy/robotether.pem",
            },
            entrypoint=["caddy", "run", "--config", "/etc/caddy/Caddyfile"],
        )

    def proxy(self, name, files, entrypoint, user=""):
        mounts = {str(file): {"bind": place, "mode": "ro"} for file, place in files.items()}
        made = self.containers.start(
            self.inside, name, volumes=mounts, entrypoint=entrypoint, user=user
        )
        self.people.connect(made)
        return made


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Our nginx with stubs behind it."""
    ensure_built("nginx", "server")
    with Containers() as containers:
        yield Site(tmp_path_factory.mktemp("site"), containers)


@pytest.fixture(scope="module", params=["nginx", pytest.param("caddy", marks=pytest.mark.release)])
def proxy(site, request):
    container = site.start_nginx() if request.param == "nginx" else site.start_caddy()
    address = site.address(container)

    def answers():
        try:
            return status(address, "/") == HTTPStatus.OK
        except OSError:
            return False

    wait_until(answers, lambda: f"the proxy answers; it says: {container.logs()!r}")
    return address


def connect(address, port=443):
    return insecure_tls().wrap_socket(
        socket.create_connection((address, port), timeout=10), server_hostname=HOST
    )


@contextmanager
def asked(address, path, port=443):
    """The answer to who asks for a page and claims another address; nothing of its body is read yet."""
    connection = http.client.HTTPConnection(HOST)
    connection.sock = connect(address, port)
    connection.request("GET", path, headers={"X-Forwarded-For": STRANGERS_CLAIM})
    with closing(connection), connection.getresponse() as answer:
        yield answer


def status(address, path):
    with asked(address, path) as answer:
        return answer.status


def seen(address, port=443):
    """Who asks whom, as web and relay hear it."""
    with asked(address, "/", port) as answer:
        return json.load(answer)


def test_people_behind_the_proxy_have_their_own_addresses(site, proxy):
    """Nobody can claim another address, and Host comes through as the browser sent it."""
    assert seen(proxy) == [site.visitor, HOST]


def test_stranger_beside_the_proxy_cannot_claim_an_address(site):
    """The header counts from a trusted proxy alone."""
    assert seen(site.address(site.stack), 8443) == [site.visitor, HOST]


def test_one_person_uses_up_no_limit_of_another(site, proxy):
    wait_until(lambda: status(proxy, "/login") == HTTPStatus.TOO_MANY_REQUESTS, lambda: "refused")
    other = ["curl", "--silent", "--insecure", "--resolve", f"{HOST}:443:{proxy}"]
    heard = run_inside(site.stack, *other, f"https://{HOST}/login").stdout
    assert json.loads(heard) == [site.address(site.stack), HOST]


def test_stream_is_passed_on_at_once(proxy):
    with asked(proxy, "/robots/sim1/video/stream") as stream:
        assert stream.read(5) == b"first"
        assert status(proxy, "/more") == HTTPStatus.OK
        assert stream.read() == b"again"


def test_websocket_comes_through(proxy):
    with connect(proxy) as browser:
        browser.sendall(
            f"GET /robots/sim1/ros HTTP/1.1\r\nHost: {HOST}\r\nConnection: Upgrade\r\n"
            "Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
        )
        got = b"".join(iter(lambda: browser.recv(4096), b""))
    assert got.startswith(b"HTTP/1.1 101 ")
    assert got.endswith(b"\r\n\r\nthrough")
