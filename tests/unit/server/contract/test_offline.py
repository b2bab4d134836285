"""Why a robot is offline, as pages say it."""

from robotether_server import __version__
from robotether_server.contract.codes import SESSION_ENDS
from robotether_server.contract.offline import offline_reason

UNKNOWN = "It is not known why."


def test_each_end_of_a_session_has_its_sentence():
    """What is unknown is said to be unknown; a shell's and the video's end end no session."""
    for code in [*SESSION_ENDS, None, "of_a_newer_server"]:
        said = offline_reason("active", code, ever_online=True)
        assert (said == UNKNOWN) == (code in {"shell_off", "unwatched", None, "of_a_newer_server"})
        assert len(said) <= 58, "a card has no room for it"


def test_an_agent_that_is_too_old_is_called_that():
    def said(version):
        return offline_reason("active", "protocol_error", ever_online=True, agent_version=version)

    assert said("0.0.9") == "Its agent 0.0.9 is too old for this server: upgrade it."
    assert "99.1 is newer than this server" in said("99.1")
    assert {said(version) for version in (None, "", "of mine", __version__)} == {
        "It sent what the server cannot read: see the agent's log."
    }


def test_the_robots_state_counts_before_its_last_session():
    """Another key is said beside the end and not instead: it may be the reason, or another machine's."""
    assert "disabled" in offline_reason("disabled", "timeout", ever_online=True)
    assert "not connected yet" in offline_reason("active", None, ever_online=False)
    text = offline_reason("active", "timeout", ever_online=True, other_key="waiting")
    assert "awaits approval" in text
    assert "went silent" in text
