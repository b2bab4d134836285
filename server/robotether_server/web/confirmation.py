"""Actions that a page confirms first: what they affect, and how to undo them.

Used by the admin pages and the profile. GET asks, POST does; an action that fails comes back with its form as it
was filled in, and the sentence that says why.
"""

from collections.abc import Callable
from dataclasses import dataclass
from http import HTTPStatus

from flask import flash, make_response, redirect, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.api.context import context
from robotether_server.db import Transaction
from robotether_server.db.audit import Source
from robotether_server.problems import Problem
from robotether_server.web import current_user

METHODS = ["GET", "POST"]


@dataclass(frozen=True)
class Field:
    """One field of the form that an action needs. `options` make it a choice of value and words."""

    name: str
    label: str
    value: str = ""
    hint: str = ""
    kind: str = "text"
    options: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class ConfirmedAction:
    """The texts of one action.

    `undo` says how to undo it, or that nobody can; `done` is shown on the page `onward` (by default `back`).
    `hidden` is sent along with the answer.
    """

    title: str
    effects: tuple[str, ...]
    undo: str
    button: str
    done: str
    back: str
    onward: str | None = None
    fields: tuple[Field, ...] = ()
    hidden: tuple[tuple[str, str], ...] = ()
    is_harmless: bool = False


def run(action: ConfirmedAction, change: Callable[[Transaction, Source], object]) -> AnyResponse:
    """Ask, or make the change in a transaction of its own when the answer has come."""

    def do() -> None:
        with context().database.transaction() as tx:
            change(tx, current_user.source())

    return ask_first(action, do)


def ask_first(
    action: ConfirmedAction, do: Callable[[], object], show_secret: Callable[[], str] | None = None
) -> AnyResponse:
    """Ask, or do it when the answer has come.

    `show_secret` makes the page that answers an action which made a secret, as no other page may hold it.
    """
    if request.method == "GET":
        return _ask(action)
    try:
        do()
    except Problem as problem:
        return _ask(action, problem)
    if show_secret is not None:
        return make_response(show_secret())
    return go_on(action.onward or action.back, action.done)


def go_on(path: str, message: str) -> AnyResponse:
    """Redirect to another page, with a message about what was done. The message must hold no secret."""
    flash(message)
    return redirect(path, HTTPStatus.SEE_OTHER)


def _ask(action: ConfirmedAction, problem: Problem | None = None) -> AnyResponse:
    page = render_template("confirm.html", action=action, problem=problem, values=request.form)
    response = make_response(page)
    response.status_code = problem.status if problem else HTTPStatus.OK
    return response
