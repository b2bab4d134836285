"""Everything that can go wrong for the agent, as one tree; every module raises only these.

Each problem has a short code that reaches the log and the status unchanged, knows whether trying again
can help, and says in one sentence what was impossible and why, and in another what a person can do.

    AgentProblem
    |- SettingsInvalid       settings_invalid     give up (exit 78)
    |- AlreadyRunning        already_running      give up (exit 75)
    |- StateUnusable         state_unusable       slowly
    |- UpgradeFailed         switch_failed        give up
    |- SshMissing            ssh_missing          slowly
    |- KeyUnusable           key_unusable         slowly
    |- InterfaceMissing      interface_missing    soon
    |- NotEnrolled           not_enrolled         ask again
    |- JoinRefused           the server's code    slowly
    |- AnswerInvalid         answer_invalid       slowly
    |- TlsUntrusted          tls_untrusted        slowly
    |- ServerUnreachable     server_unreachable   soon
    |  `- ServerBusy         server_busy          soon
    |- NoAnswer              no_answer            at once
    |- ServerKeyChanged      host_key_changed     give up (exit 76)
    |- KeyRefused            key_refused          soon
    |- SshIncompatible       ssh_incompatible     slowly
    |- LinkProblem
    |  |- LinkLost           link_lost            soon
    |  |- ServerSilent       server_silent        soon, or at once when another connection gets an answer
    |  |- NetworkChanged     network_changed      at once
    |  |- ProtocolBroken     protocol_error       soon
    |  |- SessionRefused     session_refused      soon
    |  |- PortTaken          port_taken           soon
    |  |- ForwardFailed      forward_failed       soon
    |  `- SessionEnded       the server's code    soon or slowly
    |- GuardDown             guard_down           told, another one is started
    |- RosbridgeDown         rosbridge_down       told, the tunnel stays
    `- VideoSourceDown       video_down           told, the tunnel stays
"""

from __future__ import annotations

from enum import Enum
from typing import ClassVar


class Retry(Enum):
    """What to do after a problem; robotether_agent.backoff turns it into seconds."""

    AT_ONCE = "at once"
    SOON = "soon"
    ASK_AGAIN = "ask again"
    SLOWLY = "slowly"
    NEVER = "never"


class AgentProblem(Exception):  # noqa: N818 - the word that status, log and server use for it
    """A sentence "cannot DO WHAT: why", with a code and an advice."""

    default_code: ClassVar[str] = "problem"
    default_retry: ClassVar[Retry] = Retry.SOON
    default_advice: ClassVar[str] = ""
    exit_code: ClassVar[int] = 1

    def __init__(
        self,
        message: str,
        *,
        advice: str | None = None,
        code: str | None = None,
        retry: Retry | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.advice = self.default_advice if advice is None else advice
        self.code = self.default_code if code is None else code
        self.retry = self.default_retry if retry is None else retry

    def __str__(self) -> str:
        sentence = f"{self.message}; {self.advice}" if self.advice else self.message
        return f"{sentence} [{self.code}]"


class SettingsInvalid(AgentProblem):
    """A key of agent.toml or an environment variable has a value that is not allowed."""

    default_code = "settings_invalid"
    default_retry = Retry.NEVER
    exit_code = 78


class AlreadyRunning(AgentProblem):
    """Another agent holds the lock of the same run directory."""

    default_code = "already_running"
    default_retry = Retry.NEVER
    exit_code = 75


class StateUnusable(AgentProblem):
    """A file that must be kept cannot be written or read."""

    default_code = "state_unusable"
    default_retry = Retry.SLOWLY


class UpgradeFailed(AgentProblem):
    """Another version of the agent cannot take this one's place, or did not come up."""

    default_code = "switch_failed"
    default_retry = Retry.NEVER


class SshMissing(AgentProblem):
    """OpenSSH's client or ssh-keygen is not installed."""

    default_code = "ssh_missing"
    default_retry = Retry.SLOWLY
    default_advice = "install the package openssh-client"


class KeyUnusable(AgentProblem):
    """The robot's own key exists but OpenSSH cannot use it."""

    default_code = "key_unusable"
    default_retry = Retry.SLOWLY


class InterfaceMissing(AgentProblem):
    """No network interface can give the robot its MAC address (yet)."""

    default_code = "interface_missing"
    default_retry = Retry.SOON


class NotEnrolled(AgentProblem):
    """The server knows the robot, but nobody has approved its key yet."""

    default_code = "not_enrolled"
    default_retry = Retry.ASK_AGAIN


class JoinRefused(AgentProblem):
    """The server answered the join with a reason why not; its code is kept."""

    default_code = "join_refused"
    default_retry = Retry.SLOWLY


class AnswerInvalid(AgentProblem):
    """Something answered that is no Robotether server, such as a captive portal."""

    default_code = "answer_invalid"
    default_retry = Retry.SLOWLY


class TlsUntrusted(AgentProblem):
    """The server's certificate is not the pinned one, or no known authority signed it."""

    default_code = "tls_untrusted"
    # Not NEVER: a robot without a battery-backed clock trusts the certificate once it knows the time.
    default_retry = Retry.SLOWLY


class ServerUnreachable(AgentProblem):
    """Something answered and refused, or the web did not answer."""

    default_code = "server_unreachable"
    default_retry = Retry.SOON


class ServerBusy(ServerUnreachable):
    """sshd itself refused a connection because it has as many log-ins under way as it takes (MaxStartups)."""

    default_code = "server_busy"
    default_advice = (
        "nothing needs to be done: robots log in one after the other, and this one tries again"
    )


class NoAnswer(AgentProblem):
    """No network, no name service, or packets that are dropped: nothing that trying again could harm."""

    default_code = "no_answer"
    # The attempts themselves take their time and leave pauses between each other.
    default_retry = Retry.AT_ONCE


class ServerKeyChanged(AgentProblem):
    """The SSH server is not the one that was pinned at the first join: perhaps an attack."""

    default_code = "host_key_changed"
    default_retry = Retry.NEVER
    exit_code = 76


class KeyRefused(AgentProblem):
    """The SSH server does not accept the robot's key."""

    default_code = "key_refused"
    # The join tells the lasting reasons; what is left is a key look-up that starts or is broken.
    default_retry = Retry.SOON
    default_advice = (
        "if this lasts, see on the server that the robot is active and its database answers"
    )


class SshIncompatible(AgentProblem):
    """Both OpenSSH ends share no algorithm, or the client does not know one of our options."""

    default_code = "ssh_incompatible"
    default_retry = Retry.SLOWLY
    default_advice = "update the package openssh-client (8.2 or newer)"


class LinkProblem(AgentProblem):
    """The connection stood or was about to stand, and this ended it."""


class LinkLost(LinkProblem):
    """The SSH connection went away."""

    default_code = "link_lost"


class ServerSilent(LinkProblem):
    """Nothing was heard, or nothing was taken, for the agreed time."""

    default_code = "server_silent"


class NetworkChanged(LinkProblem):
    """This robot has another address, or another way to the server."""

    default_code = "network_changed"
    default_retry = Retry.AT_ONCE


class ProtocolBroken(LinkProblem):
    """The server sent a line that the protocol does not know."""

    default_code = "protocol_error"


class SessionRefused(LinkProblem):
    """The session command on the server ended before it sent a configuration."""

    default_code = "session_refused"


class PortTaken(LinkProblem):
    """The server does not open the robot's port for this connection."""

    default_code = "port_taken"


class ForwardFailed(LinkProblem):
    """The running SSH client did not take a forward for another reason."""

    default_code = "forward_failed"


class SessionEnded(LinkProblem):
    """The server said goodbye; its code is kept."""

    default_code = "session_ended"


class GuardDown(AgentProblem):
    """The guard process has ended or hangs; the next one stops the robot."""

    default_code = "guard_down"


class RosbridgeDown(AgentProblem):
    """rosbridge on the robot does not answer; never ends a connection."""

    default_code = "rosbridge_down"


class VideoSourceDown(AgentProblem):
    """web_video_server on the robot does not answer; never ends a connection."""

    default_code = "video_down"
