"""When the guard's zeros begin and end."""

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from robotether_agent.guard.topics import ZERO_EVERY_S, ZEROS, ZEROS_AFTER_RECONNECT, Deadman

TIMEOUT_S = 0.5
TOPIC = "/cmd_vel"


def run_zeros(deadman, now, until):
    sent = []
    while (due_at := deadman.next_at()) is not None and due_at <= until:
        now = max(now, due_at)
        for name in deadman.due(now):
            deadman.zeroed(name, now)
            sent.append(now)
    return sent


def moving():
    deadman = Deadman(TIMEOUT_S)
    deadman.commanded(TOPIC, 0.0, moves=True)
    return deadman


def test_a_zero_that_a_command_overtook_does_not_end_the_motion():
    """It was sent before, and the robot moves."""
    deadman = moving()
    deadman.stop([TOPIC], 0.1)
    deadman.commanded(TOPIC, 0.1, moves=True)
    assert not deadman.is_at_rest(TOPIC)
    for _ in range(ZEROS):
        deadman.zeroed(TOPIC, 0.1)
    assert deadman.state == "moving"
    assert deadman.next_at() == 0.1 + TIMEOUT_S


def test_each_command_begins_the_time_anew():
    deadman = moving()
    for tick in range(1, 40):
        assert deadman.due(tick * 0.4) == []
        deadman.commanded(TOPIC, tick * 0.4, moves=True)
    assert deadman.state == "moving"


def test_a_loss_does_not_prolong_zeros_that_run():
    deadman = moving()
    deadman.stop([TOPIC], 0.1)
    first = run_zeros(deadman, 0.1, 0.3)
    deadman.stop([TOPIC], 0.3)
    assert len(first) + len(run_zeros(deadman, 0.3, 60.0)) == ZEROS


def test_a_zero_that_cannot_be_sent_stays_owed():
    """The half second begins with the first one that rosbridge took."""
    deadman = moving()
    for tick in range(100):
        now = TIMEOUT_S + tick * (ZERO_EVERY_S + 0.001)
        assert deadman.due(now) == [TOPIC]
        deadman.postponed(TOPIC, now)
        assert deadman.owes
    sent = run_zeros(deadman, now, 60.0)
    assert len(sent) == ZEROS
    assert not deadman.owes


def test_topics_have_phases_of_their_own():
    """One arm of the robot that stands does not keep the other from its zeros."""
    deadman = moving()
    deadman.commanded("/other", 0.4, moves=True)
    assert deadman.due(0.6) == [TOPIC]
    deadman.zeroed(TOPIC, 0.6)
    assert deadman.moving() == ["/other"]
    assert deadman.is_moving("/other")
    assert deadman.state == "moving"


class AnyEvents(RuleBasedStateMachine):
    """Whatever happens in whatever order, a robot that was told to move is told to stand in time."""

    def __init__(self):
        super().__init__()
        self.deadman = Deadman(TIMEOUT_S)
        self.now = 0.0
        self.moved_at = None
        self.takes_since = 0.0
        self.can_send = True

    def _let_time_pass(self, seconds):
        end = self.now + seconds
        while (due_at := self.deadman.next_at()) is not None and due_at <= end:
            self.now = max(self.now, due_at)
            for name in self.deadman.due(self.now):
                if self.can_send:
                    self.deadman.zeroed(name, self.now)
                    self.moved_at = None
                else:
                    self.deadman.postponed(name, self.now)
        self.now = end

    @rule(seconds=st.floats(0, 1))
    def time_passes(self, seconds):
        self._let_time_pass(seconds)

    # The drive controller sends no command while rosbridge takes none or a zero is owed.
    @precondition(lambda self: self.can_send and not self.deadman.owes)
    @rule(moves=st.booleans())
    def a_command(self, *, moves):
        self.deadman.commanded(TOPIC, self.now, moves=moves)
        self.moved_at = self.now if moves else None

    @rule()
    def somebody_is_lost(self):
        self.deadman.stop([TOPIC], self.now)

    @rule()
    def a_stop(self):
        self.deadman.force([TOPIC], self.now)

    @rule()
    def rosbridge_dies(self):
        self.deadman.stop([TOPIC], self.now)
        self.deadman.restart_zeros()
        self.can_send = False

    @rule()
    def rosbridge_lives(self):
        if not self.can_send:
            self.takes_since = self.now
        self.can_send = True

    @invariant()
    def no_motion_outlives_the_deadman_time(self):
        if self.moved_at is not None and self.can_send:
            begun = max(self.moved_at, self.takes_since)
            assert self.now <= begun + TIMEOUT_S + ZERO_EVERY_S + 1e-6

    def teardown(self):
        self.can_send = True
        self._let_time_pass(TIMEOUT_S + (ZEROS_AFTER_RECONNECT + 2) * ZERO_EVERY_S)
        assert self.moved_at is None
        assert self.deadman.state == "idle"
        assert self.deadman.next_at() is None


TestAnyEvents = AnyEvents.TestCase


def test_a_topic_is_forgotten_when_it_stands_and_not_before():
    """Else the zeros of a robot in motion would be forgotten with it."""
    deadman = Deadman(0.5)
    deadman.commanded("/moves", 0.0, moves=True)
    deadman.commanded("/stands", 0.0, moves=False)
    deadman.force(["/zeroed"], 0.0)
    deadman.forget(())
    assert set(deadman._topics) == {"/moves", "/zeroed"}
    deadman.zeroed("/stands", 0.0)
    deadman.postponed("/stands", 0.0)
    assert deadman.moving() == ["/moves"]
    assert deadman.due(0.1) == ["/zeroed"]
    deadman.commanded("/moves", 0.1, moves=False)
    deadman.forget(["/zeroed"])
    assert deadman.next_at() == 0.0
