"""Extension points: things found by name, built in or from any installed package.

A package adds one in a single file and one line of its metadata, the entry point. Built-in ones
come first, in their order, then those of other packages by name.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar

from crowdbench.messages import nearest, short

T = TypeVar("T")


class UnknownNameError(ValueError):
    """A name that nothing has, or whose package cannot be loaded; the message says which."""


class Registry(Mapping[str, T], Generic[T]):
    """A mapping from names to objects of one kind; an object of a package loads when asked for."""

    def __init__(
        self, kind: str, group: str, builtin: Mapping[str, T | str], of: type[Any]
    ) -> None:
        """Start with what is built in.

        Args:
            kind: what the objects are, as messages say it, e.g. ``"metric"``.
            group: entry-point group under which other packages add theirs.
            builtin: by name; ``module:attribute`` stands for an object that loads when asked for.
            of: what an object has to be an instance of.
        """
        self._kind, self._group, self._of = kind, group, of
        self._known: dict[str, T] = {}
        self._builtin: dict[str, EntryPoint] = {}
        for name, value in builtin.items():
            if isinstance(value, str):
                self._builtin[name] = EntryPoint(name, value, group)
            else:
                self._known[name] = value
        self._points: dict[str, EntryPoint] | None = None

    def register(self, name: str, value: T) -> None:
        """Add an object for this process alone; worker processes see entry points only.

        Raises:
            ValueError: the name is taken, or the object is of another kind.
        """
        if name in self:
            raise ValueError(f"{self._kind} {name!r} is there already")
        self._known[name] = self._checked(name, value)

    def __getitem__(self, name: str) -> T:
        """The object of a name.

        Raises:
            UnknownNameError: nothing has it (the nearest are listed), or it cannot be loaded.
        """
        if name not in self._known:
            point = self._builtin.get(name) or self._others().get(name)
            if point is None:
                raise UnknownNameError(self.unknown(name))
            try:
                value = point.load()
            except Exception as error:
                raise UnknownNameError(
                    f"{self._kind} {name!r} ({point.value}) cannot be loaded: "
                    f"{type(error).__name__}: {error}"
                ) from error
            self._known[name] = self._checked(name, value)
        return self._known[name]

    def __contains__(self, name: object) -> bool:
        return name in self._known or name in self._builtin or name in self._others()

    def __iter__(self) -> Iterator[str]:
        return iter(list(dict.fromkeys([*self._builtin, *self._known, *self._others()])))

    def __len__(self) -> int:
        return len(list(iter(self)))

    def unknown(self, name: str) -> str:
        """What to say of a name that nothing has: the nearest, or all there are."""
        return f"unknown {self._kind} {short(name)}{nearest(name, list(self))}"

    def _others(self) -> dict[str, EntryPoint]:
        if self._points is None:
            points = sorted(entry_points(group=self._group), key=lambda point: point.name)
            taken = self._known.keys() | self._builtin.keys()
            self._points = {p.name: p for p in points if p.name not in taken}
        return self._points

    def _checked(self, name: str, value: T) -> T:
        if not isinstance(value, self._of):
            kind = f"{self._of.__module__}.{self._of.__qualname__}"
            raise UnknownNameError(f"{self._kind} {name!r}: {value!r} is not a {kind}")
        return value


class ClassRegistry(Registry[type[T]]):
    """A registry of the subclasses of one class."""

    def __init__(self, kind: str, group: str, builtin: Mapping[str, str], base: str) -> None:
        """Start with what is built in.

        Args:
            kind, group, builtin: as of every registry.
            base: ``module:attribute`` of the class that all are derived from; it is imported when
                the first of them is.
        """
        super().__init__(kind, group, builtin, of=type)
        self._base = base

    def _checked(self, name: str, value: type[T]) -> type[T]:
        base = EntryPoint(name, self._base, self._group).load()
        if not (isinstance(value, type) and issubclass(value, base)):
            place = self._base.replace(":", ".")
            raise UnknownNameError(f"{self._kind} {name!r}: {value!r} is not a subclass of {place}")
        return value
