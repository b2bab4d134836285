"""What every test that talks to this machine itself needs: a free port, and requests to a self-signed certificate."""

from __future__ import annotations

import itertools
import json
import random
import socket
import ssl
import urllib.error
import urllib.request
from collections.abc import Mapping
from typing import Any

# Below the ports that the kernel gives to clients and to servers on port 0: one of those would otherwise take a port
# that a test has only noted down so far. Above those of robots, which test_direct publishes, and those that are kept
# for shells in the unit tests' database, where robots get some of these.
_FIRST, _END = 24_050, 32_000
# Maximum number of processes that test on this machine at a time, pytest-xdist's workers of all runs.
_SHARES = 20


def _claim_share() -> range:
    """Claim ports that no other process of tests notes down, until this one ends: it keeps an abstract Unix socket."""
    size = (_END - _FIRST) // _SHARES
    for number in range(_SHARES):
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(f"\0robotether test ports {number}")
        except OSError:
            claim.close()
            continue
        claim.detach()
        return range(_FIRST + number * size, _FIRST + (number + 1) * size)
    raise AssertionError(f"{_SHARES} processes have claimed all ports for tests")


PORTS = _claim_share()
# All in turn, from any on: the run before may have left some busy for a while.
_turns = itertools.cycle(PORTS)
for _ in range(random.SystemRandom().randrange(len(PORTS))):
    next(_turns)


def free_port() -> int:
    return free_ports(1)[0]


def free_ports(count: int) -> range:
    """Return `count` free ports in a row; no port is given again before all others were."""
    for _ in PORTS:
        first, *others = itertools.islice(_turns, count)
        ports = range(first, first + count)
        if others == list(ports[1:]) and all(map(_is_free, ports)):
            return ports
    raise AssertionError(f"no {count} free ports in a row in {PORTS}")


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        try:
            probe.bind(("", port))
        except OSError:
            return False
        return True


def insecure_tls() -> ssl.SSLContext:
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
