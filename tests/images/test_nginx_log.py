"""nginx's log as JSON, of an nginx alone: nothing of a request ends its line or gets out of its place."""

import http.client
import json
import re
from contextlib import closing

from image_names import ensure_built, image
from local_network import insecure_tls
from nginx_alone import Containers, address_in
from openssh_server import wait_until

PATH = "/robots/x%0a%7b%22level%22%3a%22info%22%7d%0d%e2%80%a8%22%5c/ros?ticket=SECRET-TICKET"
HEADERS = {"Cookie": "__Host-robotether_login=SECRET-LOGIN", "X-Request-ID": 'f" \\forged'}


def ask(address):
    """The status of the answer; 0: nginx starts."""
    try:
        with closing(http.client.HTTPSConnection(address, 8443, context=insecure_tls())) as https:
            https.request("GET", PATH, headers=HEADERS)
            return https.getresponse().status
    except OSError:
        return 0


def test_a_request_is_one_json_line_without_its_query():
    ensure_built("nginx")
    with Containers() as containers:
        network = containers.network()
        nginx = containers.start(network, image("nginx"), environment={"LOG_FORMAT": "json"})
        address = address_in(network, nginx)
        wait_until(
            lambda: ask(address) == http.client.SERVICE_UNAVAILABLE, lambda: str(nginx.logs())
        )
        # Written after the answer, and by way of the engine.
        wait_until(lambda: b"request_id" in nginx.logs(stderr=False), lambda: str(nginx.logs()))
        log = nginx.logs(stderr=False).decode()
        lines = [json.loads(line) for line in log.rstrip("\n").split("\n")]
    assert {"nginx"} == {line["logger"] for line in lines}
    assert lines[-1]["path"] == '/robots/x\n{"level":"info"}\r\u2028"\\/ros'
    assert lines[-1]["status"] == http.client.SERVICE_UNAVAILABLE
    assert re.fullmatch("[0-9a-f]{32}", lines[-1]["request_id"])
    assert "SECRET" not in log
