"""Deeds that a page asks about before it does them: what it affects, and whether it can be undone.

Used by the admin pages and the profile. GET asks, POST does; a deed that fails comes back with its form as it
was filled in, and the sentence that says why.
"""

from collections.abc import Callable
from dataclasses import dataclass
from http import HTTPStatus

from flask import flash, make_response, redirect, render_template, request
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.problems import Problem
from robotether_server.store import Transaction
from robotether_server.store.audit import Source
from robotether_server.web import visitors
from robotether_server.web.parts import parts

METHODS = ["GET", "POST"]


@dataclass(frozen=True)
class Field:
    """One field of the form that a deed needs. `options` make it a choice of value and words."""

    name: str
    label: str
    value: str = ""
    hint: str = ""
    kind: str = "text"
    options: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Deed:
    """One deed, in words.

    `undo` says how to take it back, or that nobody can; `done` is told on the page `onward` (`back` when it
    is not given). `hidden` goes along with the answer.
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


def run(deed: Deed, change: Callable[[Transaction, Source], object]) -> AnyResponse:
    """Ask, or make the change in a transaction of its own when the answer has come."""

    def do() -> None:
        with parts().database.transaction() as tx:
            change(tx, visitors.source())

    return ask_first(deed, do)


def ask_first(
    deed: Deed, do: Callable[[], object], show_secret: Callable[[], str] | None = None
) -> AnyResponse:
    """Ask, or do it when the answer has come.

    `show_secret` makes the page that answers a deed which made a secret, as no other page may hold it.
    """
    if request.method == "GET":
        return _ask(deed)
    try:
        do()
    except Problem as problem:
        return _ask(deed, problem)
    if show_secret is not None:
        return make_response(show_secret())
    return go_on(deed.onward or deed.back, deed.done)


def go_on(path: str, message: str) -> AnyResponse:
    """Show another page, with a message that says what was done. The message must hold no secret."""
    flash(message)
    return redirect(path, HTTPStatus.SEE_OTHER)


def _ask(deed: Deed, problem: Problem | None = None) -> AnyResponse:
    page = render_template("deed.html", deed=deed, problem=problem, values=request.form)
    response = make_response(page)
    response.status_code = problem.status if problem else HTTPStatus.OK
    return response
