#!/usr/bin/python
"""Ansible module: looks at a robot before anything is changed. Runs on the robot and changes nothing.

With what it imports it is for Python 3.8, which robots have whose agent runs in a container.
"""

from __future__ import annotations

import base64
import hashlib
import http.client
import os
import shutil
import socket
import ssl
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from ansible.module_utils.basic import AnsibleModule
from ansible_collections.robotether.robotether.plugins.module_utils.server import (
    ServerError,
    digits_of,
    host_and_port,
    reason_of,
    trusting,
)

DOCUMENTATION = r"""
module: preflight
short_description: Finds everything that would stop a robot's enrolment
description:
  - Checks disk space, the server as this robot sees it, and its rosbridge. C(problems) holds one sentence for
    each thing that is wrong, which says what to do.
options:
  server: {description: HOST or HOST:PORT of the server's https, type: str, required: true}
  tls_fingerprint: {description: SHA-256 of the server's certificate; empty asks authorities, type: str, default: ""}
  ca_file: {description: A file on the robot with certificates in PEM to trust, type: path}
  http_proxy:
    description: C(http://[USER:PASSWORD@]HOST:PORT) of the proxy that the robot goes through; empty when it needs none
    type: str
    default: ""
  rosbridge_url: {description: Where the robot's rosbridge must answer; empty when it need not, type: str, default: ""}
  folders: {description: Where the agent is installed, type: list, elements: path, required: true}
  free_mb: {description: Megabytes that must be free in each of them, type: int, required: true}
author: ["Robotether"]
"""

EXAMPLES = r"""
- name: Check a robot
  robotether.robotether.preflight:
    server: robots.example.com
    rosbridge_url: ws://127.0.0.1:9090
    folders: [/opt]
    free_mb: 150
  register: checked
"""

RETURN = r"""
problems: {description: sentences, empty when all is well, type: list, elements: str, returned: success}
"""

TIMEOUT_S = 8.0
MB = 1024 * 1024


def main() -> None:
    """Run all checks and return what they found."""
    module = AnsibleModule(
        argument_spec={
            "server": {"type": "str", "required": True},
            "tls_fingerprint": {"type": "str", "default": ""},
            "ca_file": {"type": "path", "default": None},
            "http_proxy": {"type": "str", "default": "", "no_log": True},
            "rosbridge_url": {"type": "str", "default": ""},
            "folders": {"type": "list", "elements": "path", "required": True},
            "free_mb": {"type": "int", "required": True},
        },
        supports_check_mode=True,
    )
    checks = (_disk, _server, _rosbridge)
    problems = [sentence for check in checks if (sentence := check(module.params))]
    module.exit_json(changed=False, problems=problems)


def _disk(params: dict[str, Any]) -> str:
    for folder in params["folders"]:
        place = Path(folder)
        while not place.exists():
            place = place.parent
        free_mb = shutil.disk_usage(place).free // MB
        if free_mb < params["free_mb"]:
            return f"{place} has {free_mb} MB free and the agent needs {params['free_mb']} MB: make room there"
        if os.statvfs(place).f_flag & os.ST_RDONLY:
            return f"{place} is mounted read-only: mount it writable (mount -o remount,rw ...) for the installation"
    return ""


def _server(params: dict[str, Any]) -> str:
    try:
        host, port = host_and_port(params["server"])
        pinned = digits_of(params["tls_fingerprint"])
        seen = _certificate(params, host, port, is_pinned=bool(pinned))
    except ServerError as problem:
        return str(problem)
    except ssl.SSLCertVerificationError as error:
        return (
            f"the certificate of {params['server']} is not trusted here ({error.verify_message}): set robotether_agent_"
            "tls_fingerprint to the SHA-256 that the server printed, and see that this robot's clock is right"
        )
    except (OSError, http.client.HTTPException) as error:
        proxy = "robotether_agent_http_proxy, " if params["http_proxy"] else ""
        return (
            f"this robot cannot reach https://{params['server']} ({reason_of(error)}): check its network, {proxy}"
            "robotether_agent_server, and that the server's port is open"
        )
    if pinned and seen != pinned:
        return (
            f"the certificate of {params['server']} has the SHA-256 {seen}, but robotether_agent_tls_fingerprint is "
            f"{pinned}: compare both with the one that the server printed; if they differ, somebody may intercept "
            "the connection"
        )
    return ""


def _certificate(params: dict[str, Any], host: str, port: int, *, is_pinned: bool) -> str:
    """Return the SHA-256 of the server's certificate; unless it is pinned, checked against the authorities."""
    context = trusting(params["ca_file"])
    if is_pinned:
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
    plain = _connected(params["http_proxy"], host, port)
    with plain, context.wrap_socket(plain, server_hostname=host) as tls:
        return hashlib.sha256(tls.getpeercert(binary_form=True) or b"").hexdigest()


def _connected(proxy: str, host: str, port: int) -> socket.socket:
    if not proxy:
        return socket.create_connection((host, port), timeout=TIMEOUT_S)
    parts = urlsplit(proxy)
    headers = {}
    if parts.username:
        login = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
        headers["Proxy-Authorization"] = f"Basic {base64.b64encode(login.encode()).decode()}"
    connection = http.client.HTTPConnection(parts.hostname or "", parts.port, timeout=TIMEOUT_S)
    connection.set_tunnel(host, port, headers)
    connection.connect()
    return connection.sock


def _rosbridge(params: dict[str, Any]) -> str:
    url = params["rosbridge_url"]
    if not url:
        return ""
    try:
        parts = urlsplit(url)
        address = (parts.hostname or "", parts.port or 9090)
        with socket.create_connection(address, timeout=TIMEOUT_S):
            return ""
    except (OSError, ValueError) as error:
        why = reason_of(error) if isinstance(error, OSError) else "it is no URL with a port"
        return (
            f"rosbridge does not answer at {url} ({why}): start it (docs/howto/ros2-robot.md, "
            "docs/howto/ros1-robot.md), correct robotether_agent_rosbridge_url, or enrol "
            "without it with robotether_agent_rosbridge_required=false"
        )


if __name__ == "__main__":
    main()
