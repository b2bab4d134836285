"""How old is what a driver sees: frames that the guard knows, and those that it does not."""

from __future__ import annotations

import pytest
from robotether_agent.guard.seen_age import (
    MAX_AGES,
    MAX_CAMERAS,
    DriverView,
    FrameTimes,
    SeenAges,
    SeenFrames,
)
from robotether_common.guard import MAX_FRAMES, MAX_SEEN_FRAMES, MAX_SEEN_S, MAX_SLOWED_S

NOW = 1000.0


@pytest.fixture
def times() -> FrameTimes:
    times = FrameTimes()
    times.note("/a", 1, NOW - 0.3, NOW - 0.2)
    times.note("/a", 2, NOW - 0.2, NOW - 0.1)
    times.note("/b", 2, NOW - 0.9, NOW)
    return times


def view(camera: object, frame: object) -> dict[str, object]:
    return {"camera": camera, "frame": frame}


def test_of_several_views_the_oldest_counts(times: FrameTimes) -> None:
    assert times.oldest_s([view("/a", 2)], NOW) == NOW - 0.2
    assert times.oldest_s([view("/a", 2), view("/b", 2), view("/a", 1)], NOW) == NOW - 0.9


@pytest.mark.parametrize(
    "forged",
    [
        [view("/a", 3)],
        [view("/a", 2), view("/a", 3)],
        [view("/c", 2)],
        [view("/a", None)],
        [view("/a", True)],
        [view("/a", 2.0)],
        [view("/a", "2")],
        [view(["/a"], 2)],
        [view("/a", [2])],
        [2],
        [],
        {},
        None,
        "/a",
        [view("/a", 2)] * (MAX_SEEN_FRAMES + 1),
    ],
)
def test_what_did_not_leave_the_robot_is_unknown(times: FrameTimes, forged: object) -> None:
    """A known frame beside it changes nothing, and a stranger may write any type."""
    assert times.oldest_s(forged, NOW) is None


@pytest.mark.parametrize(
    ("seen", "may_follow"),
    [
        ([view("/a", 3)], True),
        ([view("/a", 2), view("/c", 1)], True),
        ([view("/a", 2)], False),
        ([view("/a", None)], False),
        ([view("/a", 3), view("/b", None)], False),
        ([2], False),
        ([], False),
        (None, False),
    ],
)
def test_only_a_frame_with_a_number_may_be_reported_yet(times, seen, may_follow):
    assert times.may_follow(seen, NOW) is may_follow


def test_an_old_frame_is_unknown(times: FrameTimes) -> None:
    assert times.oldest_s([view("/a", 2)], NOW - 0.2 + MAX_SEEN_S) == NOW - 0.2
    assert times.oldest_s([view("/a", 2)], NOW - 0.1 + MAX_SEEN_S) is None


def test_of_two_frames_of_one_number_the_older_counts(times: FrameTimes) -> None:
    """Receivers of a camera could use one number at the same time; no frame is of the future."""
    times.note("/a", 2, NOW - 0.05, NOW)
    assert times.oldest_s([view("/a", 2)], NOW) == NOW - 0.2
    times.note("/a", 5, NOW + 3, NOW)
    assert times.oldest_s([view("/a", 5)], NOW) == NOW


def test_memory_of_frames_is_bounded() -> None:
    times = FrameTimes()
    for number in range(MAX_FRAMES + 1):
        times.note("/a", number, NOW, NOW)
    assert times.oldest_s([view("/a", 0)], NOW) is None
    assert times.oldest_s([view("/a", 1)], NOW) == NOW
    for number in range(MAX_CAMERAS):
        times.note(f"/{number}", 1, NOW, NOW)
    assert times.oldest_s([view("/a", 1)], NOW) is None
    assert times.oldest_s([view("/0", 1)], NOW) == NOW
    times.note("/0", 2, NOW - MAX_SEEN_S - 1, NOW + 1)
    times.note("/0", 3, NOW + 20, NOW + 20)
    assert len(times._cameras["/0"]) == 1


def seen_frames(taken_s: float | None) -> SeenFrames:
    return SeenFrames(taken_s, DriverView(), 13)


def test_an_age_is_never_negative() -> None:
    assert seen_frames(NOW).age_s(NOW - 0.01) == 0
    assert seen_frames(NOW).age_s(NOW + 0.14) == pytest.approx(0.14)
    assert seen_frames(None).age_s(NOW) is None


def test_ages_are_of_one_drive() -> None:
    ages = SeenAges()
    for age_s in (0.14, None):
        ages.begin(13)
        ages.add(age_s)
    ages.slowed_s, ages.limits = 0.05, (0.52, 1.0)
    assert (ages.fence, ages.ages_ms) == (13, [140.0, None])
    ages.begin(14)
    ages.add(0.2)
    assert (ages.fence, ages.ages_ms, ages.slowed_s, ages.limits) == (14, [200.0], 0.0, None)


def test_a_time_beyond_its_bound_is_reported_as_the_bound() -> None:
    """The relay counts no more; older ones end a session for it."""
    ages = SeenAges()
    ages.begin(13)
    ages.slowed_s = 1e9
    assert ages.report()["slowed_s"] == MAX_SLOWED_S


def test_nothing_is_reported_of_a_program_on_the_robot() -> None:
    """A report without a lease's number ends the session, also of a driver whose topic is slowed beside the program."""
    ages = SeenAges()
    ages.begin(13)
    ages.add(0.14)
    ages.begin(0)
    ages.slowed_s += 0.05
    assert not ages.has_news


@pytest.mark.parametrize("first", [0.0, 0.1])
@pytest.mark.parametrize("worst", [9.0, None])
def test_the_worst_age_is_never_lost(worst: float | None, first: float) -> None:
    ages = SeenAges()
    for age_s in [first] * (MAX_AGES + 5) + [worst] + [0.1] * 5:
        ages.add(age_s)
    assert len(ages.ages_ms) == MAX_AGES
    assert ages.ages_ms[-1] == (None if worst is None else 9000)
