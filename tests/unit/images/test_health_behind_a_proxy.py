"""Health checks in images where Docker's client gives each container the address of a proxy (~/.docker/config.json)."""

import os
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread

import pytest
from commands import output_of_command

IMAGES = Path(__file__).resolve().parents[3] / "images"
# Nothing listens there: whoever asks it fails.
PROXY = {"http_proxy": "http://127.0.0.1:9", "https_proxy": "http://127.0.0.1:9"}


class Well(BaseHTTPRequestHandler):
    """Answers 200."""

    def do_GET(self):
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_):
        pass


@pytest.fixture
def port():
    """That of a program that is well."""
    with HTTPServer(("127.0.0.1", 0), Well) as server:
        thread = Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        yield server.server_port
        server.shutdown()
        thread.join()


@pytest.mark.parametrize(
    ("image", "argument"), [("nginx", "http://127.0.0.1:{}/"), ("prometheus", "{}")]
)
def test_no_proxy_is_asked(port, image, argument):
    environment = {"PATH": os.environ["PATH"], **PROXY}
    output_of_command(IMAGES / image / "healthy", argument.format(port), env=environment)
