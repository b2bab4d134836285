"""What a robot's settings may hold, what they mean, and what is kept of them."""

import json

import pytest
from drive_settings import DOCK, LIGHTS
from hypothesis import given
from hypothesis import strategies as st
from robotether_common.ros import MAX_GLOBS
from robotether_server.problems import FieldInvalidError
from robotether_server.settings.buttons import MAX_BUTTONS
from robotether_server.settings.page import MAX_CAMERAS
from robotether_server.settings.robot import DEFAULTS, parse

BUTTONS_POLICY = {"drive": {"publish": ["/lights"], "call": ["/dock"]}}
NAMES = (
    *("page", "buttons", "cameras", "kind", "fps", "guard", "policy"),
    *("shell_user", "drive", "limits", "deadman_ms", "publish", "x"),
)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(NAMES) | st.text(), inner, max_size=4)
    ),
    max_leaves=12,
)


def test_only_drivers_have_the_drive_topics():
    """An observer's level never includes them, whatever the settings."""
    levels = [DEFAULTS.policy.of(level) for level in ("observe", "drive", "manage")]
    assert [level.drives for level in levels] == [False, True, True]
    assert parse({"policy": {"drive": {"publish": []}}}).policy.drive.drives


WRONG = {
    "shell_user": ("Root", "pi\n  ProxyCommand sh", "-x", "x" * 33),
    "guard": (None,),
    "guard.deadman_ms": (199, 2001, None),
    "guard.max_speed_m_s": (0, -1, 101, float("nan")),
    "guard.drive_topics": ([], "/cmd_vel", ["cmd_vel"], ["/a"] * (MAX_GLOBS + 1)),
    "policy.observe.subscribe": ([7], ["/" + "a" * 256]),
    "policy.manage.serve": ({"a": 1},),
    "help.pool": ("Night Shift",),
    "help.geofence": (
        [[0, 0], [1, 1]],
        [[0, 0]] * 33,
        [[0, 0], [1, 1], [1, True]],
        [[0, 0], [1, 1], [1, float("nan")]],
        [[0, 0], [1, 1], [1, 1e8]],
        [[0, 0], [1, 1], 7],
    ),
}


@pytest.mark.parametrize(
    ("path", "value"), [(path, value) for path, values in WRONG.items() for value in values]
)
def test_a_wrong_value_is_named(path, value):
    *parents, last = path.split(".")
    settings = {last: value}
    for parent in reversed(parents):
        settings = {parent: settings}
    with pytest.raises(FieldInvalidError, match=f"cannot use {path}: "):
        parse(settings)


FRONT = {"topic": "/camera/image_raw", "name": "Front", "turned_deg": 180}


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        ({"max_speed": 1}, "settings: 'max_speed' is not a setting"),
        ({"guard": {"key": "x"}}, "guard: 'key' is not a setting"),
        ({"policy": {"admin": {}}}, "policy: 'admin' is not a setting"),
        ({"policy": {"observe": {"publish": ["*"]}}}, "policy.observe: 'publish' is not a setting"),
        ({"policy": {"observe": {"call": ["*"]}}}, "policy.observe: 'call' is not a setting"),
        ({"policy": {"drive": {"serve": ["*"]}}}, "policy.drive: 'serve' is not a setting"),
        ({"policy": {"drive": {"drives": False}}}, "policy.drive: 'drives' is not a setting"),
        ({"policy": {"limits": {"rate": 1}}}, "policy.limits: 'rate' is not a setting"),
        ({"page": {"cameras": [{**FRONT, "quality": 5}]}}, "page.cameras.1: 'quality' is not a"),
        ({"page": {"hold_after_ms": 299}}, "page.hold_after_ms: it must be null or a whole number"),
        ({"page": {"cameras": [FRONT] * (MAX_CAMERAS + 1)}}, "page.cameras: it must be a list of"),
        ({"page": {"cameras": [FRONT, FRONT]}}, "page.cameras: /camera/image_raw is there twice"),
        ({"page": {"cameras": [{**FRONT, "topic": "/a?b=c"}]}}, "page.cameras.1.topic: it must be"),
        ({"page": {"quality_min": 81}}, "page.quality_min: 81 is over the highest quality, 80"),
        ({"page": {"width": 640}}, "page.width: give width and height, or neither"),
        ({"page": {"video": "none", "cameras": [FRONT]}}, "page.video: the page has cameras"),
        ({"buttons": {}}, "buttons: it must be a list"),
        ({"buttons": [LIGHTS] * (MAX_BUTTONS + 1)}, "buttons: it must be a list of at most"),
        ({"buttons": [LIGHTS, LIGHTS]}, "buttons: there are two of the name 'Lights on'"),
        ({"buttons": [LIGHTS, "Dock"]}, "buttons.2: it must be a JSON object"),
        ({"buttons": [{**DOCK, "msg": {}}]}, "buttons.1: 'msg' is not a setting"),
        (
            {"help": {"navigation_silent_s": 60}},
            "help.navigation_silent_s: give help.navigation_topic",
        ),
    ],
)
def test_what_is_no_setting_or_does_not_fit_together_is_refused(settings, why):
    """A limit with a typing error would be no limit, and no observer can be made a driver here."""
    with pytest.raises(FieldInvalidError, match=f"cannot use {why}"):
        parse(settings)


def test_a_button_that_no_driver_may_press_is_refused():
    """Nobody finds out by a button that does nothing."""
    settings = parse({"policy": BUTTONS_POLICY, "buttons": [LIGHTS, DOCK]})
    assert parse(settings.as_given()) == settings
    with pytest.raises(FieldInvalidError, match="does not let a driver publish /lights; an admin"):
        parse({"buttons": [LIGHTS]})
    with pytest.raises(FieldInvalidError, match=r"button 'Dock'.*policy\.drive\.call, or the"):
        parse({"policy": {"drive": {"publish": ["/lights"]}}, "buttons": [LIGHTS, DOCK]})


def test_no_button_moves_a_robot():
    """A drive topic is for the controls alone, even if the policy lets drivers publish to it."""
    button = {**LIGHTS, "topic": "/base/cmd_vel"}
    policy = {"drive": {"publish": ["*"], "call": ["*"]}}
    with pytest.raises(FieldInvalidError, match="/base/cmd_vel is a drive topic of this robot"):
        parse({"policy": policy, "buttons": [button]})
    with pytest.raises(FieldInvalidError, match="/lights is a drive topic of this robot"):
        parse({"policy": policy, "guard": {"drive_topics": ["/l*"]}, "buttons": [LIGHTS]})


def test_robot_gets_the_rules_for_help_and_not_the_pool():
    """A name of the page's stands for one that is not given here."""
    settings = {
        "page": {"odometry_topic": "/wheels", "diagnostics_topic": "/health"},
        "help": {"pool": "night", "stopped": "on", "geofence": [[0, 0], [9, 0], [9, 9]]},
    }
    rules = parse(settings).help_rules
    assert (rules["diagnostics_topic"], rules["pose_topic"]) == ("/health", "/wheels")
    assert (rules["stopped"], rules["geofence"]) == (True, ((0, 0), (9, 0), (9, 9)))
    assert "pool" not in rules


def test_the_page_drives_on_what_the_guard_watches():
    """Nothing would stop a robot that is driven past its guard."""
    assert parse({"page": {"drive_topic": "/base/cmd_vel"}}).page.drive_topic == "/base/cmd_vel"
    with pytest.raises(FieldInvalidError, match=r"page\.drive_topic: /wheels is not a drive topic"):
        parse({"page": {"drive_topic": "/wheels"}})
    assert parse(
        {"guard": {"drive_topics": ["/wheels"]}, "page": {"drive_topic": "/wheels"}}
    ).page.drive_topic


@given(VALUES)
def test_whatever_is_given_is_refused_or_kept(value):
    try:
        settings = parse(value)
    except FieldInvalidError:
        return
    assert parse(json.loads(json.dumps(settings.as_given()))) == settings
