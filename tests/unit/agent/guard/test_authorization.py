"""Who may drive."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_agent.guard.authorizer import AGENT_SILENT_S, Authorizer, DriveNotAuthorizedError
from robotether_agent.guard.drive_messages import DriveMessageRefusedError
from robotether_agent.guard.topics import Authorization

NOW = 100.0


def authorizer(*, fence=13, direct=False):
    made = Authorizer(NOW)
    made.key, made.direct = "k1", direct
    made.session(up=True)
    if fence is not None:
        made.lease(fence, held=True)
    return made


def headers(mode="drive", fence=13, key="k1"):
    return {"Robotether-Key": key, "Robotether-Mode": mode, "Robotether-Fence": str(fence)}


def status(rights, given_):
    with pytest.raises(DriveNotAuthorizedError) as refused:
        rights.authorize(given_)
    return refused.value.status


def kind(rights, authorization, fence=13, now=NOW):
    with pytest.raises(DriveMessageRefusedError) as refused:
        rights.check(authorization, fence, now)
    return refused.value.kind


def test_the_lease_drives_with_the_key():
    rights = authorizer()
    authorization = rights.authorize(headers())
    assert authorization == Authorization("drive", 13)
    rights.check(authorization, 13, NOW)
    assert rights.holds(authorization)
    assert rights.keeps(authorization)
    assert not rights.holds(Authorization("observe", 13))


@pytest.mark.parametrize(
    "given_",
    [
        {}, headers(key="k2"), headers(key=""), headers(key="k\udcff"), headers(mode="direct"), headers(mode=""),
        headers(fence=""), headers(fence="-1"), headers(fence="0"), headers(fence="1e3"), headers(fence="٣"),
        headers(fence="9" * 30), headers(fence="0" * 18 + "135"),
    ],
)  # fmt: skip
def test_other_handshakes_are_refused(given_):
    assert status(authorizer(), given_) == 403


def test_a_new_guard_lets_nobody_in():
    """Before it has a key of its own, and drive before the session is up."""
    rights = Authorizer(NOW)
    assert rights.key == ""
    assert status(rights, headers(key="")) == 403
    assert status(rights, {}) == 403
    rights.key = "k1"
    assert status(rights, headers()) == 409


def test_a_handshake_may_be_faster_than_the_line_of_its_lease():
    """Only the server knows the key, so its newer number counts at once."""
    rights = authorizer()
    old = rights.authorize(headers())
    new = rights.authorize(headers(fence=14))
    rights.lease(13, held=False)
    assert kind(rights, old) == "fence"
    rights.check(new, 14, NOW)
    rights.lease(14, held=True)
    rights.check(new, 14, NOW)
    rights.lease(14, held=False)
    assert kind(rights, new, 14) == "fence"


def test_a_new_guard_holds_nothing():
    """The driver before its start must come with a newer number, whatever the line of its lease says."""
    rights = Authorizer(NOW, 13)
    rights.key = "k1"
    rights.session(up=True)
    assert status(rights, headers()) == 409
    rights.lease(13, held=True)
    assert status(rights, headers()) == 409
    assert rights.authorize(headers(fence=14)).fence == rights.fence == 14


def test_a_new_configuration_begins_no_new_session():
    """It says again that the session stands; a number that is over stays over."""
    rights = authorizer(fence=14)
    rights.session(up=True)
    rights.lease(13, held=True)
    assert not rights.holds(Authorization("drive", 13))
    assert rights.holds(Authorization("drive", 14))


@pytest.mark.parametrize("fence", [None, "13", 13.0, True, 12, 14])
def test_a_message_shows_its_connections_fence(fence):
    rights = authorizer(fence=13)
    assert kind(rights, Authorization("drive", 13), fence) == "fence"


def test_a_stop_refuses_and_ends_the_lease():
    """A release alone does not bring the driver back."""
    rights = authorizer()
    authorization = rights.authorize(headers())
    rights.stop()
    assert kind(rights, authorization) == "stopped"
    assert status(rights, headers(fence=14)) == 409
    rights.release()
    assert kind(rights, authorization) == "fence"
    assert rights.authorize(headers(fence=14)).fence == 14


def test_a_silent_agent_holds_the_robot_until_it_speaks():
    """Its silence may be a session that is lost without a word."""
    rights = authorizer()
    authorization = rights.authorize(headers())
    late = NOW + AGENT_SILENT_S
    assert kind(rights, authorization, now=late) == "held"
    rights.on_agent_message(late)
    rights.check(authorization, 13, late)


def test_a_lost_session_ends_drivers_and_keeps_observers():
    rights = authorizer(direct=True)
    drive, observe, direct = (
        rights.authorize(headers()),
        rights.authorize(headers("observe")),
        rights.authorize({}),
    )
    rights.session(up=False)
    assert [rights.keeps(item) for item in (drive, observe, direct)] == [False, True, False]
    assert kind(rights, drive) == "held"


def test_direct_connections_drive_while_nobody_has_the_lease():
    rights = authorizer(fence=None, direct=True)
    direct = rights.authorize({})
    rights.check(direct, None, NOW)
    rights.lease(1, held=True)
    assert kind(rights, direct, None) == "fence"
    assert rights.keeps(direct)
    rights.lease(1, held=False)
    rights.check(direct, None, NOW)
    rights.direct = False
    assert not rights.keeps(direct)
    assert status(rights, {}) == 403


def test_a_guard_that_ends_moves_nothing():
    rights = authorizer()
    authorization = rights.authorize(headers())
    rights.exiting = True
    assert kind(rights, authorization) == "held"
    assert status(rights, headers()) == 409


EVENTS = st.lists(
    st.tuples(
        st.sampled_from(["held", "over", "door", "stop", "release", "session"]), st.integers(1, 6)
    ),
    max_size=30,
)


@given(EVENTS)
def test_an_old_fence_never_passes(events):
    """Whatever comes in whatever order: only the newest number drives, and none that ended."""
    rights = authorizer(fence=None)
    newest, over = 0, set()
    for what, fence in events:
        if what == "held":
            rights.lease(fence, held=True)
            newest = max(newest, fence)
        elif what == "over":
            rights.lease(fence, held=False)
            newest = max(newest, fence)
            over |= {fence} if fence == newest else set()
        elif what == "door":
            try:
                newest = max(newest, rights.authorize(headers(fence=fence)).fence)
            except DriveNotAuthorizedError:
                continue
        elif what == "stop":
            rights.stop()
            over.add(newest)
        elif what == "session":
            rights.session(up=False)
            rights.session(up=True)
            over.add(newest)
        else:
            rights.release()
        for number in range(1, 7):
            if number < newest or number in over:
                assert not rights.holds(Authorization("drive", number))
                assert status(rights, headers(fence=number)) == 409
