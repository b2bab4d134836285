"""nginx keeps its connections to other cells, asked of the daemon with stubs in the place of relay and cell."""

import http.client
from contextlib import closing

import pytest
from image_names import ensure_built, image
from local_network import insecure_tls
from nginx_alone import Containers, address_in
from openssh_server import wait_until
from site_cells import make_peer_keys

# Of one nginx's workers each has connections of its own.
WORKERS = 2
REQUESTS = 20
# A relay that sends nginx to a cell, which is here, too, and whose answer names the connection.
STUBS = """
import socket, ssl, threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

cell = socket.gethostbyname(socket.gethostname()) + ":8444"

class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def answer(self, status, text="", **headers):
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name.replace("_", "-"), value)
        if status == 200:
            self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        self.wfile.write(text.encode())

class Relay(Handler):
    def do_GET(self):
        stops = self.path.endswith("/stop")
        self.answer(204, X_Accel_Redirect="@cell_or_here" if stops else "@cell", X_Robotether_Cell=cell)

class Inside(Handler):
    def do_GET(self):
        self.answer(200, f"{cell}\\n;injected;\\n")

class Cell(Handler):
    def do_GET(self):
        if self.headers["Upgrade"]:
            self.answer(101, Upgrade="websocket", Connection="upgrade")
            self.close_connection = True
        else:
            self.answer(200, str(self.client_address[1]))

def serve(port, handler, tls=None):
    server = ThreadingHTTPServer(("", port), handler)
    if tls:
        server.socket = tls.wrap_socket(server.socket, server_side=True)
    threading.Thread(target=server.serve_forever).start()

tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
tls.load_cert_chain("/keys/peer_cert.pem", "/keys/peer_key.pem")
tls.load_verify_locations("/keys/peer_cert.pem")
tls.verify_mode = ssl.CERT_REQUIRED
serve(8444, Cell, tls)
serve(9100, Inside)
serve(8080, Relay)
"""


@pytest.fixture
def nginx(tmp_path):
    """The address of an nginx whose site has a certificate for its cells."""
    keys = make_peer_keys(tmp_path)
    for file in keys.iterdir():
        file.chmod(0o444)
    keys.chmod(0o755)
    ensure_built("nginx", "server")
    with Containers() as containers:
        network = containers.network()
        command = ["python3", "-c", STUBS]
        stubs = containers.start(
            network, image("server"), "relay", "web", command=command, volumes=[f"{keys}:/keys:ro"]
        )
        made = containers.start(network, image("nginx"), volumes=[f"{keys}:/etc/nginx/own:ro"])
        address = address_in(network, made)
        wait_until(
            lambda: connections(address, 1) == 1, lambda: f"{made.logs()!r} {stubs.logs()!r}"
        )
        yield address


def forward(address, action="control", **headers):
    """The answer of the cell: its status, and the port from which nginx's request came."""
    path = "/robots/sim1/ros" if headers else f"/api/v1/robots/sim1/{action}"
    with closing(http.client.HTTPSConnection(address, 8443, context=insecure_tls())) as https:
        https.request("GET", path, headers=headers)
        answer = https.getresponse()
        return answer.status, "" if headers else answer.read().decode()


def connections(address, requests):
    """Return over how many connections the cell gets this number of requests; 0: nginx reloads or starts."""
    try:
        answers = {forward(address) for _ in range(requests)}
    except OSError:
        return 0
    return len(answers) if {status for status, _ in answers} == {200} else 0


def test_forwarded_requests_share_kept_connections(nginx):
    """A TLS handshake for each would take both machines' time from who drives."""
    wait_until(
        lambda: 0 < connections(nginx, REQUESTS) <= WORKERS,
        lambda: f"{REQUESTS} requests come to the cell over at most {WORKERS} connections",
    )
    # A machine that is gone does not accept a new connection, and leaves a kept one open.
    stops = [forward(nginx, "stop") for _ in range(REQUESTS)]
    assert len(set(stops)) == REQUESTS
    assert {status for status, _ in stops} == {200}
    assert forward(nginx, Connection="Upgrade", Upgrade="websocket")[0] == 101
