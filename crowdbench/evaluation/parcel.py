"""An agent on its way to another machine: with the files that its name and options speak of.

The other machine gets a copy of them at the same paths below a folder of its own.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from crowdbench.agent import AgentError, AgentSpec
from crowdbench.evaluation.protocol import Answer, Broken, Done, Lost, Refused
from crowdbench.messages import quoted


@dataclass(frozen=True)
class Parcel:
    """An agent and its files.

    Attributes:
        agent: as it was named.
        folder: in which it was named.
        files: their content by absolute path.
    """

    agent: AgentSpec
    folder: str
    files: Mapping[str, bytes]

    @classmethod
    def of(cls, agent: AgentSpec) -> Parcel:
        """Read the agent's ``file.py`` and every file that is the value of an option.

        Raises:
            AgentError: a file cannot be read.
        """
        folder, files = str(Path.cwd()), {}
        for name in _named_files(agent):
            try:
                files[_absolute(folder, name)] = Path(name).read_bytes()
            except OSError as error:
                reason = f"{name}: {error.strerror}"
                raise AgentError(f"agent {quoted(str(agent))}: {reason}") from error
        return cls(agent, folder, files)

    def unpack(self, root: Path) -> AgentSpec:
        """Write the files below a folder; returns the agent by the names that they have now."""
        for name, content in self.files.items():
            path = Path(f"{root}{name}")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)

        def there(name: str) -> str:
            path = _absolute(self.folder, name)
            return f"{root}{path}" if path in self.files else name

        name, separator, rest = self.agent.name.partition(":")
        options = self.agent.options.items()
        moved = {key: there(one) if isinstance(one, str) else one for key, one in options}
        return AgentSpec(f"{there(name)}{separator}{rest}", moved)


def without_root(answer: Answer | Lost, root: Path) -> Answer | Lost:
    """An answer that names files by the paths that they have on the machine they came from."""

    def told(text: str) -> str:
        return text.replace(str(root), "")

    if isinstance(answer, Done):
        driven = [
            replace(one, error=told(one.error)) if one.error else one for one in answer.driven
        ]
        return Done(driven, tuple(map(told, answer.warned)))
    if isinstance(answer, Refused) and isinstance(answer.error, AgentError):
        return Refused(AgentError(told(str(answer.error))))
    if isinstance(answer, Broken):
        return Broken(told(answer.traceback))
    if isinstance(answer, Lost):
        return replace(answer, reason=told(answer.reason))
    return answer


def _named_files(agent: AgentSpec) -> Iterator[str]:
    path = agent.name.partition(":")[0]
    if path.endswith(".py"):
        yield path
    for value in agent.options.values():
        if isinstance(value, str) and value and _is_file(value):
            yield value


def _absolute(folder: str, name: str) -> str:
    return os.path.normpath(Path(folder, name))


def _is_file(path: str) -> bool:
    try:
        return Path(path).is_file()
    except (OSError, ValueError):  # too long, or a null byte
        return False
