"""Parts of error messages: a value cut short, the nearest name, what is allowed in words."""

from __future__ import annotations

import difflib
import reprlib
import signal
import traceback
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

MAX_LENGTH = 100
"""Of a value in a message [characters]."""
MAX_NAME = 300
"""Of the name of a file or an agent in a message [characters]."""
MAX_PROBLEMS = 5
"""That one message names; of the rest it gives the number."""
MAX_REASON = 200
"""Of what a library says of a file [characters]."""
_LONGEST_ERROR = 800

_OUT_OF_RANGE = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")
_LIMITS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<=", "multiple_of": "a multiple of"}


@dataclass(frozen=True)
class Form:
    """What a field takes, in words, where its type alone does not say it; goes into Annotated."""

    words: str


class _Short(reprlib.Repr):
    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxstring, self.maxother = 2, MAX_LENGTH - 20, MAX_LENGTH - 20

    def repr_int(self, x: int, level: int) -> str:
        # Python refuses to write numbers of more than 4,300 digits, and long ones take long.
        return repr(x) if x.bit_length() < 200 else f"a number of {x.bit_length()} bits"


class _ShortSetting(_Short):
    def repr_NoneType(self, x: None, level: int) -> str:  # noqa: N802 - the type's name
        return "null"

    def repr_bool(self, x: bool, level: int) -> str:
        return "true" if x else "false"


def short(value: object) -> str:
    """A value as Python writes it, in one line of at most 100 characters, however large it is."""
    return _cut(_Short().repr(value))


def setting(value: object) -> str:
    """The same of a value from a YAML file, which knows null, true and false."""
    return _cut(_ShortSetting().repr(value))


def _cut(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= MAX_LENGTH else f"{text[: MAX_LENGTH - 3]}..."


def brief(error: BaseException) -> str:
    """What a library says, in one line of at most 200 characters."""
    text = " ".join(str(error).split())
    return text if len(text) <= MAX_REASON else f"{text[: MAX_REASON - 3]}..."


def printable(text: object) -> str:
    """A path or name from outside as it is, or as Python writes it where a terminal could not."""
    return str(text) if str(text).isprintable() else repr(str(text))


def quoted(name: str) -> str:
    """The name of a file or an agent as Python writes it, whole unless it is absurdly long."""
    return repr(name) if len(name) <= MAX_NAME and name.isprintable() else short(name)


def nearest(word: str, known: list[str]) -> str:
    """Say what may have been meant: ``"; did you mean 'x'?"`` or the list of known words."""
    close = difflib.get_close_matches(word[:MAX_LENGTH], known, n=1, cutoff=0.6)
    return f"; did you mean {close[0]!r}?" if close else f"; known: {', '.join(known)}"


def plain_text(text: str) -> str:
    """Text of a class of foreign code's own as Python's own, which does only what it says."""
    return str.__str__(text)


def describe_error(error: BaseException) -> str:
    """Type, text and place of an exception that foreign code has raised, in one line."""
    text = _line(error, lambda: "".join(traceback.format_exception_only(error)))
    frames = traceback.extract_tb(error.__traceback__)
    files = [frame for frame in frames if frame.filename and not frame.filename.startswith("<")]
    return f"{text} ({files[-1].filename}:{files[-1].lineno})" if files else text


def describe_text(error: BaseException) -> str:
    """Text of an exception that foreign code has raised, in one line; its type without one."""
    return _line(error, lambda: str(error))


def _line(error: BaseException, write: Callable[[], str]) -> str:
    try:
        text = plain_text(" ".join(write().split())) or type(error).__name__
    except BaseException as another:  # what writes an exception is foreign code too
        if is_interrupt(another):
            raise
        text = type(error).__name__
    return text if len(text) <= _LONGEST_ERROR else f"{text[: _LONGEST_ERROR - 3]}..."


def is_interrupt(error: BaseException) -> bool:
    """Whether an exception is Ctrl-C, and not a KeyboardInterrupt that foreign code has raised.

    Where the signal is handled in another way, as in worker processes, it cannot be.
    """
    handler = signal.getsignal(signal.SIGINT)
    return isinstance(error, KeyboardInterrupt) and handler is signal.default_int_handler


def allowed(annotation: Any, metadata: tuple[Any, ...] = ()) -> str:
    """What a type takes, in words: ``a whole number >= 1 and <= 32``.

    Args:
        annotation: a type hint, ``Annotated`` or not.
        metadata: limits and a ``Form`` that belong to it, as pydantic keeps them.
    """
    annotation, metadata = _unwrapped(annotation, metadata)
    options = get_args(annotation)
    if get_origin(annotation) in (Union, types.UnionType):
        kinds = [allowed(o, metadata) for o in options if o is not types.NoneType]
        return " or ".join(kinds) + ", or null" * (types.NoneType in options)
    if get_origin(annotation) is Literal:
        *others, last = map(repr, options)
        return f"{', '.join(others)} or {last}" if others else last
    words = next((item.words for item in metadata if isinstance(item, Form)), None)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return words or "a section of `key: value` lines"
    if get_origin(annotation) is tuple:
        each = _limits(_unwrapped(options[0], ())[1])
        return f"{words or 'two numbers'}{f', each {each}' if each else ''}"
    kinds_of_value = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
    return f"{words or kinds_of_value.get(annotation, 'a value')} {_limits(metadata)}".strip()


def explain(error: ValidationError, model: type[BaseModel]) -> str:
    """Pydantic's complaints as sentences with the dotted field and what it takes, in one line."""
    items = _one_each(error.errors(include_url=False))
    sentences = [_sentence(item, model) for item in items[:MAX_PROBLEMS]]
    more = len(items) - len(sentences)
    return "; ".join(sentences) + (f"; and {more} more" if more > 0 else "")


def _one_each(items: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """One complaint about each field: where numbers are missing, that, or else the first."""
    kept: dict[tuple[str | int, ...], Mapping[str, Any]] = {}
    for item in items:
        *field, last = item["loc"] or ("",)
        place = tuple(field) if isinstance(last, int) else (*field, last)
        if place not in kept or (item["type"] == "missing" and isinstance(last, int)):
            kept[place] = item
    return list(kept.values())


def _sentence(item: Mapping[str, Any], model: type[BaseModel]) -> str:
    places = list(_walk(item["loc"], model))
    # Numbers tell the sections of a list apart; the last one is a place in a pair.
    *sections, last = item["loc"] or ("",)
    words = [str(part) for part in sections] + [last] * isinstance(last, str)
    if item["type"] != "extra_forbidden":  # a union's branches have names in brackets
        words = [word for word in words if not word.startswith("<")]
    field = ".".join(words)
    field = field if len(field) <= MAX_LENGTH else f"{field[: MAX_LENGTH - 3]}..."
    value = setting(item["input"])
    if item["type"] == "extra_forbidden":
        section, _ = places[-1]
        word = str(item["loc"][-1])
        elsewhere = list(_fields_called(word, model))
        meant = f"; did you mean {' or '.join(map(repr, elsewhere))}?" if elsewhere else ""
        return f"unknown key {short(field)}{meant or nearest(word, list(section.model_fields))}"
    if item["type"] == "invalid_key":
        section = f"{'.'.join(map(str, item['loc'][:-1]))}: " if item["loc"][:-1] else ""
        return f"{section}the key {setting(item['input'])} is not a name"
    annotation, metadata = places[-1]
    if item["type"] == "value_error":
        text = str(item["ctx"]["error"])
        # What a section as a whole complains of begins with the name of a field.
        whole = isinstance(annotation, type) and issubclass(annotation, BaseModel)
        return f"{field}{'.' if whole else ': '}{text}" if field else text
    if item["type"] in _OUT_OF_RANGE:
        union = get_origin(annotation) in (Union, types.UnionType)
        limits = _limits(_unwrapped(annotation, metadata)[1])
        limits = allowed(annotation, metadata) if union else limits
        return f"{field}: {value} is out of range; allowed: {limits}"
    if item["type"] == "missing" and isinstance(item["loc"][-1], str):
        return f"{field}: missing; expected {allowed(annotation, metadata)}"
    if item["type"] == "too_long" and any(hasattr(limit, "max_length") for limit in metadata):
        longest, length = item["ctx"]["max_length"], item["ctx"]["actual_length"]
        return f"{field}: {length} are too many; allowed: {longest} at most"
    if isinstance(item["loc"][-1] if item["loc"] else None, int):
        annotation, metadata = places[-2]
    return f"{field or model.__name__}: expected {allowed(annotation, metadata)} (got {value})"


def _fields_called(word: str, model: type[BaseModel]) -> Iterator[str]:
    """Dotted names of the fields of that very name in a model and its sections."""
    for name, field in model.model_fields.items():
        if name == word:
            yield name
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from (f"{name}.{within}" for within in _fields_called(word, field.annotation))


def _walk(
    location: tuple[str | int, ...], model: type[BaseModel]
) -> Iterator[tuple[Any, tuple[Any, ...]]]:
    """Type and metadata of the model, then of every part of a location within it."""
    annotation: Any = model
    yield annotation, ()
    for part in location:
        if isinstance(part, str) and part in getattr(annotation, "model_fields", {}):
            field = annotation.model_fields[part]
            annotation = field.annotation
            yield annotation, tuple(field.metadata)
        elif isinstance(part, int):
            pair = _unwrapped(annotation, ())[0]
            options = get_args(pair) if get_origin(pair) in (Union, types.UnionType) else (pair,)
            pairs = [_unwrapped(option, ())[0] for option in options]
            elements = [get_args(p)[0] for p in pairs if get_origin(p) is tuple]
            if elements:
                annotation = elements[0]
                yield annotation, ()


def _unwrapped(annotation: Any, metadata: tuple[Any, ...]) -> tuple[Any, tuple[Any, ...]]:
    """The type within Annotated, and all metadata, with pydantic's fields taken apart."""
    if get_origin(annotation) is Annotated:
        metadata = (*annotation.__metadata__, *metadata)
        annotation = get_args(annotation)[0]
    flat: list[Any] = []
    for item in metadata:
        flat += item.metadata if isinstance(item, FieldInfo) else [item]
    return annotation, tuple(flat)


def _limits(metadata: tuple[Any, ...]) -> str:
    """What metadata states: ``>= 16 and a multiple of 16``; empty where it states nothing."""
    return " and ".join(
        f"{words} {getattr(limit, key)}"
        for key, words in _LIMITS.items()
        for limit in metadata
        if hasattr(limit, key)
    )
