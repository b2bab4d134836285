"""/api/v1/users: who may log in; for admins. /api/v1/me: the caller."""

from typing import Annotated

from msgspec import UNSET, Meta, Struct, UnsetType

from robotether_server import passwords
from robotether_server.api.auth import Caller
from robotether_server.api.operations import Created, operation
from robotether_server.db import users
from robotether_server.db.users import Role, User
from robotether_server.schemas import AT_LEAST_ONE, UserName
from robotether_server.services import users as user_service

# passwords.hash_password checks it, with better messages.
Password = Annotated[
    str,
    Meta(
        extra_json_schema={"minLength": passwords.MIN_LENGTH, "maxLength": passwords.MAX_LENGTH},
        extra={"as_typed": True},
    ),
]


class NewUser(Struct, forbid_unknown_fields=True):
    """A new user; without `password` one is made."""

    name: UserName
    role: Role
    password: Password | UnsetType = UNSET


class UserChanges(Struct, forbid_unknown_fields=True):
    """Changes of a user."""

    role: Role | UnsetType = UNSET
    disabled: bool | UnsetType = UNSET
    password: Password | UnsetType = UNSET


class ShownUser(Struct):
    """A user, as admins see one."""

    name: UserName
    role: Role
    disabled: bool


class AddedUser(ShownUser):
    """A user, with the password if it was made: it is shown once."""

    password: str | UnsetType = UNSET


class UserList(Struct):
    """Users, by name."""

    users: list[ShownUser]


class Me(Struct):
    """The caller."""

    name: UserName
    role: Role


@operation("GET", "/users", "admin")
def list_users(caller: Caller) -> UserList:
    """List users."""
    return UserList([_describe(user) for user in users.list_all(caller.tx)])


@operation("POST", "/users", "admin", problems=(409,))
def add_user(caller: Caller, body: NewUser) -> Created[AddedUser]:
    """Add a user."""
    password, new_password = body.password, None
    if password is UNSET:
        password = new_password = passwords.new_password()
    added = user_service.add(caller.tx, caller.source, body.name, password, body.role)
    return AddedUser(added.name, added.role, added.disabled, new_password or UNSET), 201


@operation("GET", "/users/<user>", "admin")
def show_user(caller: Caller, user: str) -> ShownUser:
    """Get a user."""
    return _describe(users.get(caller.tx, user))


@operation("PATCH", "/users/<user>", "admin", problems=(409,))
def change_user(caller: Caller, user: str, body: Annotated[UserChanges, AT_LEAST_ONE]) -> ShownUser:
    """Change the given members, all or none.

    The last enabled admin can neither be disabled nor lose the role. A new password ends all logins.
    """
    tx, source = caller.tx, caller.source
    if body.role is not UNSET:
        user_service.set_role(tx, source, user, body.role)
    if body.disabled is not UNSET:
        user_service.set_disabled(tx, source, user, disabled=body.disabled)
    if body.password is not UNSET:
        user_service.set_password(tx, source, user, body.password)
    return _describe(users.get(tx, user))


@operation("DELETE", "/users/<user>", "admin", problems=(409,))
def remove_user(caller: Caller, user: str) -> None:
    """Remove the user with grants, API tokens and SSH keys."""
    user_service.remove(caller.tx, caller.source, user)


@operation("DELETE", "/users/<user>/logins", "admin")
def log_out_everywhere(caller: Caller, user: str) -> None:
    """End all logins of the user."""
    user_service.log_out_everywhere(caller.tx, caller.source, user)


@operation("GET", "/me", "user")
def me(caller: Caller) -> Me:
    """Get the caller's name and role."""
    return Me(caller.user.name, caller.user.role)


def _describe(user: User) -> ShownUser:
    return ShownUser(user.name, user.role, user.disabled)
