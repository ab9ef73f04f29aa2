"""An agent on its way to another machine: with the files that its name and options speak of.

The other machine gets a copy of them at the same paths below a folder of its own, and makes the
agent in the copy of the folder that this process is in, so that relative names mean the same there.
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
    """An agent as it was named, and the content of its files by their absolute paths."""

    agent: AgentSpec
    files: Mapping[str, bytes]

    @classmethod
    def of(cls, agent: AgentSpec) -> Parcel:
        """Read the agent's ``file.py`` and every file that is the value of an option.

        Raises:
            AgentError: a file cannot be read.
        """
        files = {}
        for name in _named_files(agent):
            try:
                files[_absolute(name)] = Path(name).read_bytes()
            except OSError as error:
                reason = f"{name}: {error.strerror}"
                raise AgentError(f"agent {quoted(str(agent))}: {reason}") from error
        return cls(agent, files)

    def unpack(self, root: Path) -> AgentSpec:
        """Write the files below a folder.

        Returns:
            The agent by the names that it has there; relative ones are as they were.
        """
        for name, content in self.files.items():
            path = below(root, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)

        def there(name: str) -> str:
            moved = Path(name).is_absolute() and _absolute(name) in self.files
            return str(below(root, name)) if moved else name

        name, separator, rest = self.agent.name.partition(":")
        options = self.agent.options.items()
        moved = {key: there(one) if isinstance(one, str) else one for key, one in options}
        return AgentSpec(f"{there(name)}{separator}{rest}", moved)


def below(root: Path, path: str) -> Path:
    """What stands for an absolute path below a folder."""
    return Path(f"{root}{_absolute(path)}")


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


def _absolute(name: str) -> str:
    return os.path.normpath(Path.cwd() / name)


def _is_file(path: str) -> bool:
    try:
        return Path(path).is_file()
    except (OSError, ValueError):  # too long, or a null byte
        return False
