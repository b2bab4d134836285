"""Runs all checks in the order in which a connection needs them; here are those of the robot itself."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import AsyncIterator
from datetime import datetime, timezone
from http import HTTPStatus
from pathlib import Path

import aiohttp

from robotether_agent import systemd
from robotether_agent.describe_error import describe_error
from robotether_agent.doctor import FAIL, Finding, fail, ok, server, skipped, tunnel, warning
from robotether_agent.doctor.encoder import check_encoder
from robotether_agent.enrolment import keys
from robotether_agent.enrolment.enroller import EnrolmentStore
from robotether_agent.enrolment.identity import IdentityStore, interface_with
from robotether_agent.exposure import (
    ADDRESS_ADVICE,
    PAST_GUARD,
    UNLESS_FIREWALL,
    exposed_at,
    rosbridge_advice,
)
from robotether_agent.fields import printable
from robotether_agent.files import FULL_ADVICE, NO_INODES, READ_ONLY
from robotether_agent.problems import AgentError
from robotether_agent.rosbridge import RosGraph
from robotether_agent.rosbridge_socket import new_http
from robotether_agent.settings import Settings
from robotether_agent.status import is_alive, read_status
from robotether_agent.tasks import within
from robotether_agent.tunnel.openssh import target_of

TIMEOUT_S = 4.0
# Minimum free space for the key and its like, and in memory for the status and what the guard notes.
ENOUGH_MB, ENOUGH_RUN_MB = 20, 1
# Parameters with which rosbridge for ROS 2 calls services and sends goals beside other messages of a connection.
IN_NEW_THREAD = ("call_services_in_new_thread", "send_action_goals_in_new_thread")
FORGET = "if this disk is a copy, make it a robot of its own: sudo robotether-agent forget"


async def run_checks(settings: Settings) -> AsyncIterator[Finding]:
    """Yield what each check finds, as soon as it is known."""
    last = read_status(settings.run_dir)
    status = last if last is not None and is_alive(last, time.time()) else None
    yield ok("settings", f"server = {settings.server}")
    yield check_disk(settings)
    yield check_mac(settings)
    yield await check_key(settings)
    seen = await server.view_server(settings)
    pinned = settings.tls_fingerprint
    name, port = server.check_name(seen), server.check_port(seen)
    yield name
    yield port
    yield server.check_certificate(seen, pinned)
    yield server.check_clock(seen, datetime.now(timezone.utc), is_pinned=pinned is not None)
    yield server.check_answer(seen)
    join = tunnel.check_join(settings, status)
    yield join
    ssh = await tunnel.check_ssh(settings, seen.ssh, (name, port))
    for finding in ssh:
        yield finding
    above = (name, port, join, *ssh)
    yield tunnel.check_service(systemd.state(), status, last, above)
    yield await check_rosbridge(settings)
    yield await check_rosapi(settings)
    yield tunnel.check_guard(settings, status)
    yield await check_video(settings)
    yield await check_encoder(settings)
    yield await check_shell(settings)
    yield tunnel.check_session(status, above)
    yield tunnel.check_end_to_end(status)


def check_disk(settings: Settings) -> Finding:
    """Whether the agent could keep its state, without which an enrolled robot connects, and the guard drive at all."""
    place, run_dir = settings.state_dir, settings.run_dir
    if not place.is_dir():
        return fail("disk", f"there is no {place}", "start the agent, or run: robotether-agent key")
    findings = [_check_room(place, ENOUGH_MB)]
    if run_dir.is_dir():
        # Else the agent makes it as it starts.
        findings.append(_check_room(run_dir, ENOUGH_RUN_MB))
    return next((finding for finding in findings if finding.state == FAIL), findings[0])


def _check_room(place: Path, enough_mb: int) -> Finding:
    step, room = "disk", os.statvfs(place)
    if room.f_flag & os.ST_RDONLY:
        return fail(step, f"{place} is read-only", READ_ONLY[1])
    if not os.access(place, os.W_OK):
        owner = f"run this with sudo; if that says the same: chown -R robotether: {place}"
        return fail(step, f"uid {os.getuid()} may not write in {place}", owner)
    free_mb = room.f_bavail * room.f_frsize // 1_000_000
    if room.f_files and not room.f_favail:
        return fail(step, f"{place}: {NO_INODES[0]}, though {free_mb} MB are", NO_INODES[1])
    if free_mb < enough_mb:
        return fail(step, f"{place} has {free_mb} MB left", FULL_ADVICE)
    return ok(step, f"{place} is writable, {free_mb} MB are free")


def check_mac(settings: Settings, root: Path = Path("/")) -> Finding:
    """Which MAC names this robot, and whether this machine has it."""
    try:
        enrolment = EnrolmentStore(settings.state_dir).load(settings.server)
        store = IdentityStore(settings, root, keeps=False)
        identity = store.identity(enrolment.mac if enrolment else None)
    except AgentError as problem:
        return fail("mac", problem.message, problem.advice)
    if not identity.is_present:
        had = identity.interface or "another interface"
        reason = f"no interface of this machine has {identity.mac}, by which the server knows it ({had} had it)"
        return fail("mac", reason, f"put the network card back; {FORGET}")
    where = interface_with(identity.mac, root) or "set in agent.toml"
    return ok("mac", f"{identity.mac} ({where})")


async def check_key(settings: Settings) -> Finding:
    """Whether the robot has a key that OpenSSH can use."""
    try:
        key = await keys.present_key(settings.state_dir)
    except AgentError as problem:
        return fail("key", problem.message, problem.advice)
    if key is None:
        return fail(
            "key", "the robot has no key yet", "start the agent, or run: robotether-agent key"
        )
    if not keys.is_protected(key.path):
        return fail(
            "key", f"others can read the private key {key.path}", f"sudo chmod 600 {key.path}"
        )
    return ok("key", key.fingerprint)


async def check_rosbridge(settings: Settings) -> Finding:
    """Whether rosbridge answers with a WebSocket."""
    url = settings.rosbridge_url
    try:
        await within(TIMEOUT_S, _open_socket(url))
    except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
        return fail(
            "rosbridge",
            f"no WebSocket at {url}: {describe_error(error, TIMEOUT_S)}",
            "start rosbridge (ros2 launch rosbridge_server rosbridge_websocket_launch.xml), or correct rosbridge_url",
        )
    if exposed := await asyncio.to_thread(exposed_at, url):
        advice = await rosbridge_advice(url)
        return warning("rosbridge", f"answers at {exposed}: {PAST_GUARD}", advice)
    return ok("rosbridge", f"answers at {url}")


async def check_rosapi(settings: Settings) -> Finding:
    """Whether rosapi answers, and whether rosbridge for ROS 2 lets a slow service block its connection."""
    graph = RosGraph(settings.rosbridge_url)
    try:
        return await _check_rosapi(graph)
    finally:
        await graph.close()


async def _check_rosapi(graph: RosGraph) -> Finding:
    try:
        topics = await graph.ask("topics", {})
    except asyncio.TimeoutError:
        return warning(
            "rosapi",
            f"is silent behind {graph.url}: pages find no topics, and the agent no battery and no cameras of rosbridge",
            "start rosapi beside rosbridge; if it runs, it hangs: restart both",
        )
    except (aiohttp.ClientError, OSError):
        return skipped("rosapi", "rosbridge, which leads to it, does not answer")
    if "topics" not in topics:
        return warning(
            "rosapi",
            f"is not known to rosbridge at {graph.url}: rosapi has ended, or roscore has restarted and knows neither",
            "restart rosbridge and rosapi; else pages find no topics, and on ROS 1 commands may reach nobody",
        )
    blocking = [name for name in IN_NEW_THREAD if await _is_off(graph, name)]
    if blocking:
        return warning(
            "rosapi",
            f"answers, but rosbridge has {' and '.join(blocking)} false: a slow service blocks its connection",
            "set it to true, as the launch file of docs/howto/ros2-robot.md does",
        )
    return ok("rosapi", "answers")


async def _is_off(graph: RosGraph, name: str) -> bool:
    """Whether rosbridge for ROS 2 says that this parameter of its own is false."""
    args = {"name": f"/rosbridge_websocket:{name}", "default_value": ""}
    try:
        answer = await graph.ask("get_param", args)
    except (aiohttp.ClientError, OSError, asyncio.TimeoutError):
        return False
    return str(answer.get("value")).strip('"').lower() == "false"


async def check_video(settings: Settings) -> Finding:
    """Whether web_video_server answers; a robot without a camera, or with other ones, has none."""
    url = settings.video_url
    if settings.video_source == "rosbridge":
        return skipped("video", "video comes from rosbridge, which is another check")
    try:
        status = await within(TIMEOUT_S, _get(url))
    except aiohttp.ClientConnectorError as error:
        reason = describe_error(error, TIMEOUT_S)
        return skipped(
            "video", f"no web_video_server at {url} ({reason}); a robot without a camera needs none"
        )
    except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
        return fail(
            "video",
            f"no answer at {url}: {describe_error(error, TIMEOUT_S)}",
            "see web_video_server's log, or correct video_url",
        )
    if status >= HTTPStatus.INTERNAL_SERVER_ERROR:
        return fail("video", f"HTTP status {status} at {url}", "see web_video_server's log")
    if exposed := await asyncio.to_thread(exposed_at, url):
        who = f"anyone in its own network can watch, {UNLESS_FIREWALL}"
        return ok("video", f"answers at {url}, and at {exposed}: {who}; or {ADDRESS_ADVICE}")
    return ok("video", f"answers at {url}")


async def check_shell(settings: Settings) -> Finding:
    """Whether the robot's own SSH server answers where shells would go."""
    if not settings.shell_address:
        return skipped("shell", "shell_address allows none")
    try:
        banner = await within(TIMEOUT_S, _banner(*target_of(f"ssh://{settings.shell_address}")))
    except (OSError, asyncio.TimeoutError) as error:
        return skipped(
            "shell",
            f"no SSH server at {settings.shell_address}: {describe_error(error, TIMEOUT_S)}",
        )
    if not banner.startswith("SSH-"):
        return skipped("shell", f"what answers at {settings.shell_address} is not an SSH server")
    return ok("shell", f"{banner} answers at {settings.shell_address}")


async def _open_socket(url: str) -> None:
    async with new_http() as http, http.ws_connect(url):
        return


async def _get(url: str) -> int:
    async with aiohttp.ClientSession() as http, http.get(url, allow_redirects=False) as response:
        return response.status


async def _banner(host: str, port: int) -> str:
    reader, writer = await asyncio.open_connection(host, port)
    try:
        return printable((await reader.readline()).decode(errors="replace"), 80)
    except ValueError:
        return ""
    finally:
        writer.close()
