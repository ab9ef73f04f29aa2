"""The machine that this process runs on, as rows and forecasts name it."""

from __future__ import annotations

import os
import platform
from pathlib import Path


def machine_name() -> str:
    """The processor and its cores; an agent has a single thread."""
    name = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next(line.partition(":")[2].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):  # not Linux, or a processor without a name
        pass
    cores = core_count()
    return f"{name}, {cores} {'core' if cores == 1 else 'cores'}, 1 thread per agent"


def core_count() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
