"""What an admin does to robots and users by the forms of their pages, one by one and to all that are ticked."""

from urllib.parse import urlencode

import pytest
from admin_visitor import fingerprint, join, send
from robotether_server.db import audit
from web_visitor import audit_kinds

PI = {"settings": {"shell_user": "pi"}}
# The subject's path, the action, its form, and the line that it leaves.
ACTIONS = (
    ("robots/sim1", "disable", {}, "robot_disabled", {}),
    ("robots/sim1", "enable", {}, "robot_enabled", {}),
    ("robots/sim1", "rotate-key", {}, "robot_rotation_requested", {}),
    ("robots/sim1", "shell-on", {}, "robot_shell_set", {"shell": True}),
    ("robots/sim1", "shell-off", {}, "robot_shell_set", {"shell": False}),
    ("robots/sim1", "mac", {"mac": "001b44113ab7"}, "robot_mac_set", {"mac": "00:1b:44:11:3a:b7"}),
    ("robots/sim1", "shell-user", {"shell_user": "pi"}, "robot_settings_set", PI),
    ("robots/sim1", "shell-user", {"shell_user": ""}, "robot_settings_set", {"settings": {}}),
    (
        "robots/sim1",
        "region",
        {"region": "eu"},
        "robot_settings_set",
        {"settings": {"region": "eu"}},
    ),
    ("robots/sim1", "ports", {"ros_port": "20100", "video_port": "20101"}, "robot_ports_moved", {}),
    ("robots/sim1", "rename", {"new_name": "lift"}, "robot_renamed", {"was": "sim1"}),
    ("robots/lift", "rekey", {}, "robot_rekeyed", {}),
    ("robots/lift", "remove", {}, "robot_removed", {}),
    ("users/ann", "role", {"role": "admin"}, "user_role_set", {}),
    ("users/ann", "disable", {}, "user_disabled", {}),
    ("users/ann", "enable", {}, "user_enabled", {}),
    ("users/ann", "password", {"password": "chosen by an admin"}, "password_set", {}),
    ("users/ann", "log-out", {}, "logins_ended", {}),
    ("users/ann", "remove", {}, "user_removed", {}),
)


def test_each_action_is_done_and_audited(admin, program, database):
    """The answer leads to the page of what was changed, or to the list if that is removed."""
    join(program, "02:00:00:00:51:01", 1)
    send(admin, "/admin/pending", robot="sim1", fingerprint=fingerprint(1), name="sim1")
    for subject, action, form, kind, details in ACTIONS:
        answer = send(admin, f"/admin/{subject}/{action}", **form)
        kinds, name = subject.split("/")
        onward = "" if action == "remove" else f"/{form.get('new_name', name)}"
        assert (answer.status_code, answer.location) == (303, f"/admin/{kinds}{onward}")
        with database.transaction() as tx:
            newest = audit.find(tx)[0]
        assert (newest.kind, newest.actor, newest.address) == (kind, "root", "198.51.100.7")
        assert details.items() <= newest.details.items()


OF_ROBOTS = {"holder": "user:ann", "level": "observe", "hours": "24"}
OF_USERS = {"scope": "robot:sim2", "level": "observe", "hours": "24"}


@pytest.mark.parametrize(
    ("of", "action", "form", "kind", "question"),
    [
        ("robot", "disable", {}, "robot_disabled", "Disable 2 robots?"),
        ("robot", "site", {"site": "yard"}, "robot_site_set", ""),
        ("robot", "grant", OF_ROBOTS, "grant_given", ""),
        ("user", "disable", {}, "user_disabled", "Disable 2 users?"),
        ("user", "group", {"group": "crew"}, "group_member_added", "Put 2 users into group crew?"),
        ("user", "grant", OF_USERS, "grant_given", "Let 2 users observe sim2, for 1 day?"),
    ],
)
def test_what_is_ticked_is_changed_after_one_question(
    *, admin, ann, database, of, action, form, kind, question
):
    names = ["sim1", "sim2"] if of == "robot" else ["ann", "olga"]
    values = ["02:00:00:00:51:01", "02:00:00:00:51:02"] if of == "robot" else names
    send(admin, "/admin/sites", name="yard")
    send(admin, "/admin/groups", name="crew")
    path = f"/admin/selected-{of}s/{action}"
    page = admin.ask("GET", path, query_string={of: values, **form}).text
    for text in (
        question,
        ", ".join(names),
        f'name="{of}s" value="{" ".join(values)}"',
        f'href="/admin/{of}s?{urlencode([(of, value) for value in values])}" '.replace(
            "&", "&amp;"
        ),
    ):
        assert text in page
    assert send(admin, path, **{f"{of}s": f"{values[0]} ghost"}, **form).status_code == 404
    assert kind not in [each for each, *_ in audit_kinds(database)]
    answer = send(admin, path, **{f"{of}s": " ".join(values)}, **form)
    assert (answer.status_code, answer.location) == (303, f"/admin/{of}s")
    assert [each for each, *_ in audit_kinds(database)].count(kind) == 2
    assert f"tick at least one {of}" in admin.ask("GET", path).text
    for wrong in ({"level": "zz"}, {"hours": "7"}):
        assert admin.ask("GET", path, query_string={of: values, **form, **wrong}).status_code == 422
