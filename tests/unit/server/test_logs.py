"""The log as JSON: whatever comes from outside stays inside one line, and secrets stay out of it."""

import io
import json
import logging
import os
import subprocess
import sys
from dataclasses import replace

import pytest
from robotether_server import logs
from robotether_server.web import create_app

REQUEST_ID = "0123456789abcdef" * 2
SECRET = "hunter2hunter2"
CONNECTION = "198.51.100.7 port 51234"
FORGED = '\n{"level": "info", "message": "ann logged in"}\r\x0b\x1b[2J\u2028\x85"\\'


@pytest.fixture
def lines():
    """What is logged meanwhile, as JSON."""
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    logs.write_json(handler)
    root = logging.getLogger()
    level = root.level
    root.addHandler(handler)
    root.setLevel(logging.INFO)
    yield lambda: [json.loads(line) for line in stream.getvalue().splitlines()]
    root.removeHandler(handler)
    root.setLevel(level)
    logs.set_request_id(None)
    logs.set_connection_id(None)


@pytest.mark.parametrize("request_id", [REQUEST_ID, None, REQUEST_ID + "\n", FORGED, "A" * 32])
def test_a_record_is_one_line_whatever_is_in_it(lines, request_id):
    logs.set_request_id(request_id)
    logs.set_connection_id(CONNECTION)
    logging.getLogger("test").error("failed: %s", FORGED, exc_info=ValueError(FORGED))
    [line] = lines()
    assert line["message"] == f"failed: {FORGED}"
    assert FORGED in line["error"]
    assert line["connection_id"] == CONNECTION
    assert line.get("request_id") == (REQUEST_ID if request_id == REQUEST_ID else None)


def test_a_request_is_one_line_without_its_query_and_credentials(lines, web_settings):
    client = create_app(replace(web_settings, log_format="json")).test_client()
    client.set_cookie("__Host-robotether_login", SECRET)
    path = "/nothing/%0a%7b%22level%22%3a%22info%22%7d"
    headers = {"X-Request-ID": REQUEST_ID, "Authorization": f"Bearer {SECRET}"}
    client.get(f"{path}?ticket={SECRET}", headers=headers)
    [line] = [line for line in lines() if line["message"] == "request"]
    assert (line["method"], line["status"], line["request_id"]) == ("GET", 404, REQUEST_ID)
    assert line["path"] == '/nothing/\n{"level":"info"}'
    assert SECRET not in json.dumps(lines())


LOGS_MUCH = """
import logging
from robotether_server import logs
logs.set_up("info", "text")
logging.info("%d", "no number")
for _ in range(2000):
    logging.info("x" * 100)
"""


def test_a_log_that_nobody_reads_holds_up_nothing():
    """A Docker daemon that hangs must not keep the relay from stopping robots."""
    unread, log = os.pipe()
    with os.fdopen(unread, "rb"), os.fdopen(log, "wb") as stderr:
        environ = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        command = [sys.executable, "-c", LOGS_MUCH]
        subprocess.run(command, stderr=stderr, env=environ, timeout=60, check=True)
