"""What every test that talks to this machine itself needs: a free port, and requests to a self-signed certificate."""

from __future__ import annotations

import json
import os
import random
import socket
import ssl
import urllib.error
import urllib.request
from collections.abc import Mapping
from typing import Any

# Below the ports that the kernel gives to clients and to servers on port 0: one of those would otherwise take a port
# that a test has only noted down so far. Above those of robots, which test_direct publishes, and those that are kept
# for shells in the unit tests' database, where robots get some of these. Each of pytest-xdist's workers has its own
# share, for the same reason.
_WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
_WORKERS = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
_FIRST = 24_050
_SHARE = (32_000 - _FIRST) // _WORKERS
PORTS = range(_FIRST + _WORKER * _SHARE, _FIRST + (_WORKER + 1) * _SHARE)
_rng = random.SystemRandom()
_given: set[int] = set()


def free_port() -> int:
    """A TCP port that was free on all of this machine's addresses a moment ago, another one each time."""
    while True:
        port = _rng.choice(PORTS)
        if port not in _given and _is_free(port):
            _given.add(port)
            return port


def free_ports(count: int) -> range:
    while True:
        first = _rng.choice(PORTS[: 1 - count])
        ports = range(first, first + count)
        if _given.isdisjoint(ports) and all(map(_is_free, ports)):
            _given.update(ports)
            return ports


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        try:
            probe.bind(("", port))
        except OSError:
            return False
        return True


def insecure_tls() -> ssl.SSLContext:
    """A TLS context that encrypts and accepts any certificate."""
    # The default context would read all of the machine's certificates, which takes longer than most requests.
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context


def request_json(
    method: str,
    url: str,
    body: Mapping[str, object] | None = None,
    headers: Mapping[str, str] | None = None,
    timeout_s: float = 10,
) -> tuple[int, Any]:
    """One HTTPS request; status and the parsed JSON (or text)."""
    request = urllib.request.Request(
        url,
        method=method,
        data=None if body is None else json.dumps(body).encode(),
        headers={"Content-Type": "application/json", **(headers or {})},
    )
    try:
        with urllib.request.urlopen(request, timeout=timeout_s, context=insecure_tls()) as answer:
            return answer.status, _parsed(answer.read())
    except urllib.error.HTTPError as error:
        with error:
            return error.code, _parsed(error.read())


def _parsed(body: bytes) -> Any:
    try:
        return json.loads(body)
    except ValueError:
        return body.decode(errors="replace")
