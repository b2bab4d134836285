"""Everything that can go wrong for the agent, as one tree.

Each problem has a short code that reaches the log and the status unchanged, knows whether trying again
can help, and says in one sentence what was impossible and why, and in another what a person can do.

    AgentError
    |- SettingsInvalidError, AlreadyRunningError, StateUnusableError, UpgradeFailedError, SshMissingError
    |- KeyUnusableError, InterfaceMissingError
    |- NotEnrolledError, JoinRefusedError, AnswerInvalidError, TlsUntrustedError
    |- ServerUnreachableError
    |  `- ServerBusyError
    |- NoAnswerError, ServerKeyChangedError, KeyRefusedError, SshIncompatibleError
    |- LinkError
    |  |- LinkLostError, ServerSilentError, NetworkChangedError, ProtocolBrokenError
    |  `- SessionRefusedError, PortTakenError, ForwardFailedError, SessionEndedError
    |- GuardDownError, RosbridgeDownError, VideoSourceDownError
    `- DetailError, whose classes stand beside what raises them
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


class AgentError(Exception):
    """A sentence "cannot DO WHAT: why", with a code and an advice."""

    default_code: ClassVar[str] = "problem"
    default_retry: ClassVar[Retry] = Retry.SOON
    default_advice: ClassVar[str] = ""
    exit_code: ClassVar[int] = 1

    def __init_subclass__(
        cls, *, code: str = "", retry: Retry = Retry.SOON, advice: str = "", exit_code: int = 1
    ) -> None:
        if code:
            cls.default_code = code
        cls.default_retry = retry
        cls.default_advice, cls.exit_code = advice, exit_code

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


class SettingsInvalidError(AgentError, code="settings_invalid", retry=Retry.NEVER, exit_code=78):
    """A key of agent.toml or an environment variable has a value that is not allowed."""


class AlreadyRunningError(AgentError, code="already_running", retry=Retry.NEVER, exit_code=75):
    """Another agent holds the lock of the same run directory."""


class StateUnusableError(AgentError, code="state_unusable", retry=Retry.SLOWLY):
    """A file that must be kept cannot be written or read."""


class UpgradeFailedError(AgentError, code="switch_failed", retry=Retry.NEVER):
    """Another version of the agent cannot take this one's place, or did not come up."""


class SshMissingError(
    AgentError,
    code="ssh_missing",
    retry=Retry.SLOWLY,
    advice="install the package openssh-client",
):
    """OpenSSH's client or ssh-keygen is not installed."""


class KeyUnusableError(AgentError, code="key_unusable", retry=Retry.SLOWLY):
    """The robot's own key exists but OpenSSH cannot use it."""


class InterfaceMissingError(AgentError, code="interface_missing"):
    """No network interface can give the robot its MAC address (yet)."""


class NotEnrolledError(AgentError, code="not_enrolled", retry=Retry.ASK_AGAIN):
    """The server knows the robot, but nobody has approved its key yet."""


class JoinRefusedError(AgentError, code="join_refused", retry=Retry.SLOWLY):
    """The server answered the join with a reason why not; its code is kept."""


class AnswerInvalidError(AgentError, code="answer_invalid", retry=Retry.SLOWLY):
    """Something answered that is not a Robotether server, such as a captive portal."""


class TlsUntrustedError(AgentError, code="tls_untrusted", retry=Retry.SLOWLY):
    """The server's certificate is not the pinned one, or no known authority signed it."""

    # Not NEVER: a robot without a battery-backed clock trusts the certificate once it knows the time.


class ServerUnreachableError(AgentError, code="server_unreachable"):
    """Something answered and refused, or the web did not answer."""


class ServerBusyError(
    ServerUnreachableError,
    code="server_busy",
    advice="nothing needs to be done: robots log in one after the other, and this one tries again",
):
    """sshd itself refused a connection because it has as many log-ins under way as it takes (MaxStartups)."""


class NoAnswerError(AgentError, code="no_answer", retry=Retry.AT_ONCE):
    """No network, no name service, or packets that are dropped: nothing that trying again could harm."""

    # The attempts themselves take their time and leave pauses between each other.


class ServerKeyChangedError(AgentError, code="host_key_changed", retry=Retry.NEVER, exit_code=76):
    """The SSH server is not the one that was pinned at the first join: perhaps an attack."""


class KeyRefusedError(
    AgentError,
    code="key_refused",
    advice="if this lasts, see on the server that the robot is active and its database answers",
):
    """The SSH server does not accept the robot's key."""


class SshIncompatibleError(
    AgentError,
    code="ssh_incompatible",
    retry=Retry.SLOWLY,
    advice="update the package openssh-client (8.2 or newer)",
):
    """Both OpenSSH ends share no algorithm, or the client does not know one of our options."""


class LinkError(AgentError, code="link_problem"):
    """The connection was up or nearly so, and this ended it."""


class LinkLostError(LinkError, code="link_lost"):
    """The SSH connection went away."""


class ServerSilentError(LinkError, code="server_silent"):
    """Nothing was received, or nothing could be sent, for the agreed time."""


class NetworkChangedError(LinkError, code="network_changed", retry=Retry.AT_ONCE):
    """This robot has another address, or another way to the server."""


class ProtocolBrokenError(LinkError, code="protocol_error"):
    """The server sent a line that the protocol does not know."""


class SessionRefusedError(LinkError, code="session_refused"):
    """The session command on the server ended before it sent a configuration."""


class PortTakenError(LinkError, code="port_taken"):
    """The server does not open the robot's port for this connection."""


class ForwardFailedError(LinkError, code="forward_failed"):
    """The running SSH client did not take a forward for another reason."""


class SessionEndedError(LinkError, code="session_ended"):
    """The server said goodbye; its code is kept."""


class GuardDownError(AgentError, code="guard_down"):
    """The guard process has ended or hangs; the next one stops the robot."""


class RosbridgeDownError(AgentError, code="rosbridge_down"):
    """rosbridge on the robot does not answer; never ends a connection."""


class VideoSourceDownError(AgentError, code="video_down"):
    """web_video_server on the robot does not answer; never ends a connection."""


class DetailError(AgentError, code="detail"):
    """Why something fails, in words alone: its caller answers it, or translates it into a problem with a code."""

    def __str__(self) -> str:
        return self.message
