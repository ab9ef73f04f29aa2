"""``--shard I/N``: a part of a run that needs nothing of the other parts."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from crowdbench.cli.common import UserError
from crowdbench.messages import short


@dataclass(frozen=True)
class Shard:
    """The I-th of N parts of a run, counted from 1."""

    number: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Read ``I/N``.

        Raises:
            UserError: it is something else, or there is no such part.
        """
        match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text, re.ASCII)
        shard = cls(int(match[1]), int(match[2])) if match else cls(0, 0)
        if not 1 <= shard.number <= shard.count:
            raise UserError(
                f"--shard {short(text)}: expected I/N with whole numbers 1 <= I <= N, e.g. 1/4"
            )
        return shard

    def seeds(self, every: range) -> range:
        """Every N-th seed: each part has some of every agent and scenario, the same for all agents.

        Raises:
            UserError: there are fewer seeds than parts.
        """
        if len(every) < self.count:
            raise UserError(
                f"--shard {self.number}/{self.count}: {len(every)} episodes per cell (--episodes) "
                f"make at most {len(every)} shards"
            )
        return every[self.number - 1 :: self.count]

    def folder(self, results: Path) -> Path:
        """The results folder of its own, within that of the whole run."""
        return results / f"shard-{self.number}-of-{self.count}"
