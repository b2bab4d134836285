"""Checks the connection over SSH: ports and host key, the boot service, and the agent's own status."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Sequence

from robotether_agent.describe_error import SILENT_ADVICE
from robotether_agent.doctor import FAIL, Finding, fail, ok, skipped, warning
from robotether_agent.enrolment import keys
from robotether_agent.enrolment.enroller import EnrolmentStore
from robotether_agent.enrolment.join import SshAccess
from robotether_agent.enrolment.keys import HostKey
from robotether_agent.net.happy_eyeballs import WHERE, said_once
from robotether_agent.net.http_proxy import proxy_of
from robotether_agent.net.server_dialer import ServerDialer, SshAddress
from robotether_agent.problems import (
    AgentError,
    KeyRefusedError,
    NoAnswerError,
    ServerKeyChangedError,
    ServerUnreachableError,
    SshMissingError,
)
from robotether_agent.settings import Settings
from robotether_agent.status import (
    CONNECTED,
    Status,
    end_to_end,
    ended_by_problem,
    has_problem,
    video_tunnel,
)
from robotether_agent.tasks import within
from robotether_agent.tunnel.openssh import (
    SILENT,
    SshFiles,
    child_environment,
    host_key_command,
    stderr_with,
    why_not_connected,
)

# Time limit for a connection attempt, slightly above the client's own ConnectTimeout.
TIMEOUT_S = 13.0
START = "sudo systemctl start robotether-agent"
AS_ABOVE = "what stands above"


def check_join(settings: Settings, status: Status | None) -> Finding:
    """Whether the server has let this robot in."""
    try:
        enrolment = EnrolmentStore(settings.state_dir).load(settings.server)
    except AgentError as problem:
        return fail("join", problem.message, problem.advice)
    if status is not None and status.state == "pending":
        return fail(
            "join", f"{status.problem} (key {status.fingerprint})", "approve it on the server"
        )
    if enrolment is None:
        why = f"this robot is not enrolled at {settings.server}"
        return fail("join", why, "run: sudo robotether-agent join")
    return ok(
        "join", f"{enrolment.server} knows this robot as {enrolment.robot} (MAC {enrolment.mac})"
    )


async def check_ssh(
    settings: Settings, announced: SshAccess | None, above: Sequence[Finding]
) -> list[Finding]:
    """Whether the server's SSH ports answer with the pinned host key; one of them is enough.

    Before the robot is enrolled, they are those that the server has `announced`.
    """
    store = EnrolmentStore(settings.state_dir)
    try:
        enrolment, pinned = store.load(settings.server), keys.pinned_host_keys(store.known_hosts)
    except AgentError as problem:
        return [fail("ssh", problem.message, problem.advice)]
    access = enrolment.ssh if enrolment else announced
    if access is None and settings.ssh_ports:
        access = SshAccess("tunnel", None, settings.ssh_ports)
    if access is None:
        return [skipped("ssh", "the server has not said at which ports robots connect")]
    targets = _targets(settings, access)
    problems = await asyncio.gather(*(_problem_at(target, store) for target in targets))
    one_works = any(isinstance(problem, KeyRefusedError) for problem in problems)
    # Ports of which the same is to be said stand in one line.
    alike: dict[str, list[tuple[SshAddress, AgentError]]] = {}
    for target, answer in zip(targets, problems, strict=True):
        alike.setdefault(_reason_of(answer, target), []).append((target, answer))
    return [_finding(group, pinned, above, one_works=one_works) for group in alike.values()]


def _reason_of(problem: AgentError, target: SshAddress) -> str:
    """Return what tells apart what is to be said of two ports."""
    if isinstance(problem, KeyRefusedError):
        return str(target)
    return problem.message.replace(str(target), target.host)


def check_service(
    state: str | None,
    status: Status | None,
    last: Status | None = None,
    above: Sequence[Finding] = (),
) -> Finding:
    """Whether the boot service runs; `state` is systemd's word, None without systemd.

    `last` is what the agent wrote before it ended.
    """
    if status is None and last is not None and ended_by_problem(last) and state != "active":
        if is_said(last.problem, above):
            return fail(
                "service",
                f"the agent has stopped for that [{last.problem_code}]",
                f"{AS_ABOVE}, then: {START}",
            )
        reason = f"the agent has stopped: {last.problem} [{last.problem_code}]"
        return fail("service", reason, last.advice or START)
    if state not in {None, "active"}:
        return fail(
            "service",
            f"systemd says that it is {state}",
            f"{START}; journalctl -u robotether-agent",
        )
    if status is None and state == "active":
        why = "systemd says that it is active, but it writes no status"
        return fail(
            "service",
            why,
            "journalctl -u robotether-agent; sudo systemctl restart robotether-agent",
        )
    if status is None:
        return fail("service", "no agent runs", START)
    return ok("service", f"robotether-agent {status.agent_version} runs (pid {status.pid:.0f})")


def check_guard(settings: Settings, status: Status | None) -> Finding:
    """Whether something stops the robot when its commands stop, and whether somebody has stopped it."""
    step = "guard"
    # An agent that runs has the settings of its start.
    if (settings.guard if status is None else status.guard) == "off":
        return skipped(step, "off in the settings: nothing stops this robot when commands stop")
    if status is None:
        return skipped(step, "no agent runs")
    if status.guard != "ready":
        detail = status.guard_detail or "it does not run"
        return fail(step, f"{status.guard}: {detail}", "journalctl -u robotether-agent says why")
    if status.stopped_by:
        return skipped(step, f"stopped by {status.stopped_by}; a driver releases it on its page")
    if status.guard_detail:
        advice = (
            "start the base's driver, or correct the drive topic on the robot's page; after a restart of roscore, "
            "restart rosbridge and the driver"
        )
        return warning(step, f"ready, but {status.guard_detail}", advice)
    return ok(step, "ready; it stops the robot when commands stop")


def is_said(problem: str, above: Sequence[Finding]) -> bool:
    """Return whether a step has failed for the same reason, which is a problem's last words."""
    reason = WHERE.sub(r"\1", problem.rpartition(": ")[2])
    return any(finding.state == FAIL and reason in finding.detail for finding in above)


def check_session(status: Status | None, above: Sequence[Finding] = ()) -> Finding:
    """Whether the robot is connected, and if not, what the agent says, unless it stands `above`."""
    if status is None:
        return skipped("connection", "no agent runs")
    if has_problem(status) and is_said(status.problem, above):
        advice = f"{AS_ABOVE}; the agent tries again by itself"
        return fail("connection", f"the agent waits for that [{status.problem_code}]", advice)
    if has_problem(status):
        return fail(
            "connection",
            f"{status.problem} [{status.problem_code}]",
            status.advice or "wait: it tries again",
        )
    if status.state != CONNECTED:
        return fail(
            "connection", f"the agent is {status.state}", "wait some seconds and check again"
        )
    video = video_tunnel(status)
    where = f" to {status.ssh}" if status.ssh else ""
    return ok("connection", f"connected{where} as {status.robot}, video tunnel {video}")


def check_end_to_end(status: Status | None) -> Finding:
    """Whether the server reaches the robot's services through the tunnels."""
    step = "end to end"
    if status is None or status.state != CONNECTED:
        return skipped(step, "not connected")
    answers = end_to_end(status)
    if status.video == "down":
        # A robot without a camera needs none.
        answers.pop("video", None)
    states = ", ".join(f"{name} {state}" for name, state in answers.items())
    if "down" in answers.values():
        return fail(
            step,
            f"from the server: {states}",
            "correct what fails above; else see the server's log",
        )
    if "unknown" in answers.values():
        return skipped(step, f"the server has not checked yet: {states}")
    return ok(step, f"from the server: {states}")


def _targets(settings: Settings, ssh: SshAccess) -> list[SshAddress]:
    dialer = ServerDialer(proxy_of(settings.http_proxy), https_port=settings.server_port)
    return [
        SshAddress(cell.host, port, ssh.user, dialer, cell)
        for cell in ssh.in_order(settings)
        for port in cell.ports
    ]


async def _problem_at(target: SshAddress, store: EnrolmentStore) -> AgentError:
    """Return what ends a connection without a key: KeyRefusedError when all before that is well."""
    try:
        connection = await (target.dialer or ServerDialer()).open(target)
    except (NoAnswerError, ServerUnreachableError) as problem:
        return problem
    with connection:
        try:
            status, words = await within(TIMEOUT_S, _ask_client(target, store, connection))
        except FileNotFoundError:
            return SshMissingError("cannot check the SSH ports: there is no OpenSSH client (ssh)")
        except asyncio.TimeoutError:
            why = f"cannot reach SSH at {target}: {SILENT}"
            return ServerUnreachableError(why, advice=SILENT_ADVICE)
    files = SshFiles((), store.known_hosts, store.known_hosts)
    return why_not_connected(words.splitlines(), status, target, files)


async def _ask_client(
    target: SshAddress, store: EnrolmentStore, connection: socket.socket
) -> tuple[int, str]:
    """Return the status and the words of a client that checks the host key on `connection`."""
    ours, clients = stderr_with(connection)
    words, end = await asyncio.open_connection(sock=ours)
    try:
        with clients:
            process = await asyncio.create_subprocess_exec(
                *host_key_command(target, store.known_hosts),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.DEVNULL,
                stderr=clients.fileno(),
                env=child_environment(),
            )
        try:
            return await process.wait(), (await words.read()).decode(errors="replace")
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
    finally:
        end.close()


def _finding(
    alike: list[tuple[SshAddress, AgentError]],
    pinned: list[HostKey],
    above: Sequence[Finding],
    *,
    one_works: bool,
) -> Finding:
    """Return what is to be said of ports with the same problem."""
    target, problem = alike[0]
    step = f"ssh {', '.join(str(at.port) for at, _ in alike)}"
    if isinstance(problem, KeyRefusedError):
        return ok(step, f"{target.host} answers with the pinned host key")
    if isinstance(problem, ServerKeyChangedError) and not pinned:
        return skipped(step, f"{target.host} answers; no host key is pinned before the first join")
    message = said_once(problem.message for _, problem in alike)
    if isinstance(problem, ServerKeyChangedError):
        fingerprints = ", ".join(key.fingerprint for key in pinned)
        return fail(step, f"{message}; pinned is {fingerprints}", problem.advice)
    if one_works:
        return skipped(step, f"{message}; another address is enough")
    if is_said(message, above):
        return skipped(step, "for the reason above")
    return fail(step, message, problem.advice)
