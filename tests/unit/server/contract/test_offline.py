"""Why a robot is offline, as pages say it."""

import pytest
from robotether_server import __version__
from robotether_server.contract.codes import SESSION_ENDS
from robotether_server.contract.offline import offline_reason

UNKNOWN = "It is not known why."


@pytest.mark.parametrize(
    "code",
    # The others end no session, but a shell or the video.
    sorted(SESSION_ENDS.keys() - {"shell_off", "unwatched"}),
)
def test_each_end_of_a_session_has_its_sentence(code):
    said = offline_reason("active", code, ever_online=True)
    assert said != UNKNOWN
    assert len(said) <= 58, "a card has no room for it"


@pytest.mark.parametrize("code", [None, "", "of_a_newer_server"])
def test_what_is_unknown_is_said_to_be_unknown(code):
    assert offline_reason("active", code, ever_online=True) == UNKNOWN


def test_an_agent_that_is_too_old_is_called_that():
    def said(version):
        return offline_reason("active", "protocol_error", ever_online=True, agent_version=version)

    assert said("0.0.9") == "Its agent 0.0.9 is too old for this server: upgrade it."
    assert "99.1 is newer than this server" in said("99.1")
    assert {said(version) for version in (None, "", "of mine", __version__)} == {
        "It sent what the server cannot read: see the agent's log."
    }


def test_a_refused_host_key_is_the_reason():
    """The robot has said it, so its last session's end explains nothing."""
    said = offline_reason("active", "link_lost", ever_online=True, other_key="host_key")
    assert said == "It refuses this server's SSH host key: see Add a robot."


def test_the_robots_state_counts_before_its_last_session():
    assert "disabled" in offline_reason("disabled", "timeout", ever_online=True)
    assert "approval" in offline_reason("pending", None, ever_online=False)
    assert "not connected yet" in offline_reason("active", None, ever_online=False)


def test_another_key_is_said_beside_the_end_and_not_instead():
    """It may be the reason, or another machine's."""
    text = offline_reason("active", "timeout", ever_online=True, other_key="waiting")
    assert "awaits approval" in text
    assert "went silent" in text
    assert "rejected" in offline_reason("active", None, ever_online=True, other_key="rejected")
