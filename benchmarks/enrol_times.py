"""How long it takes until a robot can be driven: `make enrol-times`.

Brings up a stack of its own, boots hosts with systemd in containers, and prints a table: seconds from the start of the
install line until the agent is connected, with packages from the index and from a folder; from the start of
`ansible-playbook enroll.yml` until every robot answered a drive connection, for one and for five bare robots, and the
same run again; and from power-on of an enrolled robot until a drive connection is answered.
"""

from __future__ import annotations

import asyncio
import sys
import tempfile
import time
from pathlib import Path

import aiohttp
from playbooks import FROM_INDEX, Played, Site
from programs import Program
from report import Row, quantiles, table
from robot_hosts import CA_BUNDLE, WHEELHOUSE, RobotHost, RobotHosts
from stack import Stack

FLEET = 5
LINES = 3
POWER_CUTS = 10
LIMIT_S = 60.0


async def answers(program: Program, robot: str) -> bool:
    """Tell whether a new drive connection gets an answer from the robot's rosbridge now."""
    try:
        async with asyncio.timeout(5), program.connect(robot) as socket:
            await socket.send_json({"op": "subscribe", "topic": "/pose", "type": "turtlesim/Pose"})
            return "pose" in await socket.receive_str()
    except (OSError, TimeoutError, TypeError, aiohttp.ClientError):
        return False


async def power_on_s(program: Program, robot: RobotHost) -> float:
    """Cut the robot's power, give it back, and return the seconds from then until it can be driven."""
    await asyncio.to_thread(robot.switch_off)
    started = time.monotonic()
    await asyncio.to_thread(robot.switch_on)
    while not await answers(program, robot.name):
        if time.monotonic() - started > LIMIT_S:
            raise SystemExit(f"{robot.name} cannot be driven {LIMIT_S:g} s after power-on")
        await asyncio.sleep(0.02)
    return time.monotonic() - started


def line_s(site: Site, robot: RobotHost, options: str) -> float:
    """Run the install line on a bare host, return the seconds until it has seen the agent connected, and undo it."""
    body = {"name": f"line-{time.monotonic_ns()}", "uses": 1, "hours": 1}
    headers = {"Authorization": f"Bearer {site.token}", "Host": f"cloud:{site.stack.https_port}"}
    _, answer = site.stack.request("POST", "/api/v1/join-tokens", body, headers)
    line = f"{answer['command']} --interface eth0 --name {robot.name} {options}"
    started = time.monotonic()
    robot.run(line)
    took_s = time.monotonic() - started
    script = f"curl -fsSk https://cloud:{site.stack.https_port}/join.sh"
    robot.run(f"{script} | sh -s -- --uninstall --yes")
    site.stack.admin.remove("robots", robot.name)
    return took_s


def row(what: str, robots: int, values: list[float]) -> Row:
    return {"what": what, "robots": robots, **quantiles(values, 0.5, 1), "runs": len(values)}


def measure(site: Site, hosts: RobotHosts) -> list[Row]:
    program = Program(site.stack, site.token)
    item = [hosts.boot("solo")]
    fleet = hosts.boot_all(*(f"fleet{number}" for number in range(1, FLEET + 1)))
    rows = []
    item[0].put(f"[global]\ncert = {CA_BUNDLE}\n".encode(), "/etc/pip.conf")
    for source, options in (("the index", ""), ("a folder", f"--wheelhouse {WHEELHOUSE}")):
        times = [line_s(site, item[0], options) for _ in range(LINES)]
        rows.append(row(f"install line with packages from {source}, to connected", 1, times))
    for robots in (item, fleet):
        for what in ("enroll.yml, first run, to drivable", "enroll.yml, second run"):
            played = site.play_well("enroll.yml", *robots)
            report(played)
            rows.append(row(what, len(robots), [played.took_s]))
    cuts = [asyncio.run(power_on_s(program, item[0])) for _ in range(POWER_CUTS)]
    rows.append(row("power-on of an enrolled robot to drivable", 1, cuts))
    return rows


def report(played: Played) -> None:
    """Show the recap on standard error, so that standard output is the table alone."""
    recap = played.printed[played.printed.index("PLAY RECAP") :].strip()
    sys.stderr.write(f"{recap}\n{played.took_s:.1f} s\n\n")


def main() -> None:
    """Bring everything up, measure, print, and remove it all."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        stack = Stack(folder / "stack")
        try:
            stack.up(robots=False)
            with RobotHosts(folder) as hosts:
                # The playbook proves each robot by a round trip of its own before it ends.
                site = Site(folder, stack, hosts, stack.token("enrol-times"))
                site.variables["robotether_agent_environment"] = str(FROM_INDEX)
                sys.stdout.write(f"{table(measure(site, hosts))}\n")
        finally:
            stack.down()


if __name__ == "__main__":
    main()
