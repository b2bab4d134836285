"""What agent and relay both say to people about a camera."""

from __future__ import annotations

from robotether_common.frames import no_frames


def test_a_topic_without_frames_is_named() -> None:
    """The name is anybody's text: it is short, and has nothing that a log would not show."""
    why = ": the topic does not exist or nothing publishes it"
    assert no_frames("/camera/x") == f"no frames from /camera/x{why}"
    assert no_frames("/a\n\x1b[b" + "c" * 200) == f"no frames from /a  [b{'c' * 94}{why}"
