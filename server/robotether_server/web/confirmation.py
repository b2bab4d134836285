"""Actions that a page confirms first, as data: what each affects, how to undo it, and what it does.

GET asks, POST does; an action that fails comes back with its form as it was filled in, and the sentence that says why.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from http import HTTPStatus

from flask import Blueprint, make_response, render_template, request
from markupsafe import escape
from werkzeug.wrappers import Response as AnyResponse

from robotether_server.api.context import context
from robotether_server.problems import RobotetherError
from robotether_server.web import current_user
from robotether_server.web.forms import METHODS, check_meant, go_on

Words = Mapping[str, object]


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
    """One action: its path, its texts, and `do(tx, source, **parts of the path)`.

    Texts name what the page knows: "Disable robot {name}?", "{robot.mac}"; `result` is what `do` returned. An effect
    without words is left out. `undo` says how to undo it, or that nobody can; `done` is shown on the page `onward` (by
    default the page that the question came from). `hidden` is sent along with the answer. If `do` returns a response,
    that is sent instead: no other page may hold a secret.
    """

    path: str
    title: str
    effects: tuple[str, ...]
    undo: str
    button: str
    done: str
    do: Callable[..., object]
    onward: str = ""
    fields: tuple[Field, ...] = ()
    hidden: tuple[tuple[str, str], ...] = ()
    is_harmless: bool = False


def register(
    blueprint: Blueprint, back: str, find: Callable[..., Words], *actions: ConfirmedAction
) -> None:
    """Make the path of each action ask and act.

    `find` returns what the texts may name, from the parts of the path, or raises a RobotetherError; as `meant` the MAC
    of a robot, or the id of another, as another one may get the name of the path. `back` is the page that the question
    came from, and may name the same.
    """
    for action in actions:
        view = _view(action, back, find)
        blueprint.add_url_rule(action.path, action.path, view, methods=METHODS)


def _view(
    action: ConfirmedAction, back: str, find: Callable[..., Words]
) -> Callable[..., AnyResponse]:
    def view(**parts: object) -> AnyResponse:
        words = find(**parts)

        def do() -> object:
            if "meant" in words:
                check_meant(str(words["name"]), str(words["meant"]))
            return context().database.run(lambda tx: action.do(tx, current_user.source(), **parts))

        return ask_first(action, back, words, do)

    return view


def ask_first(
    action: ConfirmedAction, back: str, words: Words, do: Callable[[], object]
) -> AnyResponse:
    """Ask, or do it when the answer has come."""
    back = back.format_map(words)
    if request.method != "POST":
        return _ask(action, back, words)
    try:
        result = do()
    except RobotetherError as problem:
        return _ask(action, back, words, problem)
    if isinstance(result, AnyResponse):
        return result
    words = {**words, "result": result}
    return go_on(action.onward.format_map(words) or back, action.done.format_map(words))


def _ask(
    action: ConfirmedAction, back: str, words: Words, problem: RobotetherError | None = None
) -> AnyResponse:
    # As markup that escapes what is none: a time among the words is the reader's own.
    effects = [escape(effect).format_map(words) for effect in action.effects]
    page = render_template(
        "confirm.html",
        action=action,
        title=action.title.format_map(words),
        effects=[effect for effect in effects if effect],
        undo=escape(action.undo).format_map(words),
        back=back,
        fields=[replace(field, value=field.value.format_map(words)) for field in action.fields],
        hidden=[(name, value.format_map(words)) for name, value in action.hidden],
        meant=request.form.get("meant", words.get("meant")),
        problem=problem,
        values=request.form,
    )
    response = make_response(page)
    response.status_code = problem.status if problem else HTTPStatus.OK
    return response
