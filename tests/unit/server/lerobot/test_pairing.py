"""Which frame, command and state belong to a step: compared with the truth of made-up drives."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recorded_drive import (
    BASE_NS,
    MS,
    RecordedDrive,
    Row,
    true_row,
)
from robotether_server.lerobot.actions import Action
from robotether_server.lerobot.export import read_drive
from robotether_server.lerobot.pairing import (
    CutReason,
    DriveData,
    EpisodeStep,
    FrameInfo,
    episodes,
    steps,
)
from robotether_server.lerobot.recording import (
    RecordedCommand,
    RecordedControl,
    RecordedState,
)

CAMERAS = {"/front": "jpeg", "/rear": "jpeg"}
FPS = 15
SPANS = st.lists(
    st.tuples(st.integers(0, 6000), st.integers(1, 2000)).map(lambda span: (span[0], sum(span))),
    max_size=2,
).map(tuple)
DRIVES = st.builds(
    RecordedDrive,
    seed=st.integers(0, 2**32),
    codecs=st.just(CAMERAS),
    seconds=st.just(6.0),
    lost=st.sampled_from([0, 0.1, 0.5]),
    missed=st.sampled_from([0, 0.05]),
    refused=st.sampled_from([0, 0.5]),
    delay_ms=st.sampled_from([20, 400, 1200]),
    drivers=st.sampled_from(
        [((150, 5800),), ((150, 2500), (2500, 5800)), ((150, 2500), (3000, 5800))]
    ),
    frozen=SPANS,
    idle=SPANS,
    stopped=SPANS,
)


def ns(at_ms):
    return BASE_NS + at_ms * MS


# Each is written as a recording, and read.
@settings(max_examples=20, suppress_health_check=list(HealthCheck))
@given(DRIVES)
def test_each_step_has_what_was_the_case_and_nothing_else_is_cut(tmp_path, recorded):
    path = recorded.write(tmp_path / "1.mcap")
    drive = read_drive(path, list(CAMERAS))
    path.unlink()
    numbers = {
        camera: [frame.number for frame in frames if frame.is_recorded]
        for camera, frames in recorded.frames.items()
    }
    for count, step in enumerate(steps(drive, list(CAMERAS), "twist", FPS)):
        at_ms = (drive.commands[0].at_ns - BASE_NS) / MS + count * 1000 / FPS
        row = None
        if isinstance(step, EpisodeStep):
            seen = [
                numbers[camera][place] for camera, place in zip(CAMERAS, step.frames, strict=True)
            ]
            ages_s = tuple(round(age_s, 6) for age_s in step.ages_s)
            row = Row(recorded.seed, tuple(seen), ages_s, step.state[0], step.action[0])
        truth = true_row(recorded, at_ms)
        assert row == (
            truth and truth._replace(ages_s=tuple(round(age, 6) for age in truth.ages_s))
        )


def step_of(frames, named, control_fence=1):
    """What a step is 100 ms after a command of each number in `named`."""
    at_ns = ns(20_000)
    drive = DriveData(
        {"/front": frames},
        [
            RecordedCommand(
                at_ns + count, 1, True, Action("twist", (0.0,) * 6), (("/front", number),)
            )
            for count, number in enumerate(named)
        ]
        + [RecordedCommand(at_ns + 100 * MS, 1, True, Action("twist", (0.0,) * 6), ())],
        [RecordedControl(at_ns, control_fence > 0, control_fence, False)],
        [RecordedState(at_ns, "/odom", "", ())],
    )
    return list(steps(drive, ["/front"], "twist", 10))[-1]


def frame(sequence, log_ms, taken_ms=None):
    return FrameInfo(sequence, ns(log_ms if taken_ms is None else taken_ms), ns(log_ms), 64, 48)


@pytest.mark.parametrize(
    ("frames", "named", "expected"),
    [
        ([frame(7, 19_900)], [7], 0),
        ([frame(7, 19_900)], [8], CutReason.UNKNOWN_FRAME),
        ([frame(7, 19_900)], [7, -1], CutReason.UNKNOWN_FRAME),
        ([frame(6, 19_800), frame(7, 19_900)], [7, 6], 1),
        ([frame(7, 15_000), frame(7, 19_900)], [7], CutReason.UNKNOWN_FRAME),
        ([frame(7, 5_000), frame(7, 19_900)], [7], 1),
        ([frame(7, 19_900, 20_900)], [7], CutReason.UNKNOWN_FRAME),
        ([frame(7, 25_000, 19_900)], [7], CutReason.UNKNOWN_FRAME),
        ([frame(7, 19_900, 0)], [7], CutReason.FROZEN),
    ],
    ids=[
        "recorded",
        "not recorded",
        "unknown to the page",
        "an older one named again",
        "two of one number",
        "one of them long ago",
        "taken in the future",
        "recorded long after",
        "a clock that is behind",
    ],
)
def test_a_frame_that_is_not_sure_is_cut(frames, named, expected):
    step = step_of(frames, named)
    assert (step if isinstance(step, CutReason) else step.frames[0]) == expected


@pytest.mark.parametrize(
    ("fence", "reason"), [(0, CutReason.NOT_DRIVEN), (-1, CutReason.UNKNOWN_DRIVER)]
)
def test_a_time_without_a_driver_is_cut(fence, reason):
    assert step_of([frame(7, 19_900)], [7], fence) is reason


def test_an_episode_has_one_driver_no_cut_and_an_end():
    one, other = (EpisodeStep(fence, (), (), (), ()) for fence in (1, 2))
    found = [one] * 3 + [other] * 2 + [CutReason.FROZEN] + [other] * 1001
    assert [len(episode) for episode in episodes(found, fps=1)] == [3, 2, 1000, 1]
