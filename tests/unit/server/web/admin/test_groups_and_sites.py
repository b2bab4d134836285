"""The pages of groups and of sites."""

import pytest
from admin_visitor import send
from robotether_server.db.grants import GROUPS, SITES


@pytest.mark.parametrize(
    ("collection", "member_kind", "member", "removal"),
    [(GROUPS, "user", "ann", "remove"), (SITES, "robot", "sim1", "take-out")],
)
def test_collection_is_added_filled_and_removed(*, admin, collection, member_kind, member, removal):
    """Each form leads to the page with the change, and a removal asks first."""
    path = f"/admin/{collection.kind}s"
    fill = f"{path}/x/{collection.members}"
    remove = f"{fill}/{member}/{removal}"

    def has_member():
        return f'href="{remove}"' in admin.ask("GET", f"{path}/x").text

    assert send(admin, path, name="x").location == f"{path}/x"
    assert not has_member()
    assert send(admin, fill, **{member_kind: member}).location == f"{path}/x"
    assert has_member()
    assert f"Add {member} again" in admin.ask("GET", remove).text
    assert send(admin, remove).location == f"{path}/x"
    assert not has_member()
    assert send(admin, remove).status_code >= 400
    send(admin, fill, **{member_kind: member})
    assert f": {member}." in admin.ask("GET", f"{path}/x/remove").text
    assert send(admin, f"{path}/x/remove").location == path
    assert admin.ask("GET", f"{path}/x").status_code == 404
