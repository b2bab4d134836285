"""Asks both servers whether they answer: `python -m sim_robot.healthcheck`, run by Docker.

Standard library only: it starts every few seconds beside the robot and must cost little.
"""

import http.client
import os
import sys

from sim_robot.settings import SettingsProblem, from_environment

TIMEOUT_S = 3.0
SWITCHING_PROTOCOLS, OK = 101, 200
_UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "c2ltIGhlYWx0aCBjaGVjaw==",
}


def main() -> int:
    """Exit code 0 when both answer."""
    try:
        settings = from_environment(os.environ)
        _ask("rosbridge", settings.rosbridge_port, _UPGRADE, SWITCHING_PROTOCOLS)
        _ask("video", settings.video_port, {}, OK)
    except (SettingsProblem, OSError, http.client.HTTPException) as error:
        sys.stderr.write(f"unhealthy: {error}\n")
        return 1
    return 0


def _ask(name: str, port: int, headers: dict[str, str], expected: int) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=TIMEOUT_S)
    try:
        connection.request("GET", "/", headers=headers)
        status = connection.getresponse().status
    finally:
        connection.close()
    if status != expected:
        raise http.client.HTTPException(f"{name} answers {status} and not {expected}")


if __name__ == "__main__":
    sys.exit(main())
