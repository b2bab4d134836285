"""Health checks in images where Docker's client gives each container the address of a proxy (~/.docker/config.json)."""

import os
from pathlib import Path

import pytest
import tls_web
from commands import output_of_command

IMAGES = Path(__file__).resolve().parents[3] / "images"
# Nothing listens there: whoever asks it fails.
PROXY = {"http_proxy": "http://127.0.0.1:9", "https_proxy": "http://127.0.0.1:9"}


def well(_environ, respond):
    respond("200 OK", [])
    return []


@pytest.mark.parametrize(("image", "argument"), [("nginx", "http://{}/"), ("prometheus", "{}")])
def test_no_proxy_is_asked(image, argument):
    environment = {"PATH": os.environ["PATH"], **PROXY}
    with tls_web.running(well) as program:
        address = program.address if image == "nginx" else program.address.split(":")[1]
        output_of_command(IMAGES / image / "healthy", argument.format(address), env=environment)
