"""Tensors of a training lie in large pages, and none is faulted in twice."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import json, resource
import torch
from crowdbench_agents.learning.memory import keep_freed_memory

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

keep_freed_memory()
keep_freed_memory()  # a second training in the same process
tensor = torch.ones(2**24)
middle = tensor.data_ptr() + 2**25
del tensor
before = faults()
for _ in range(5):
    torch.ones(2**24)
flags = []
for line in open("/proc/self/smaps"):
    first, *rest = line.split()
    if "-" in first:
        low, high = (int(x, 16) for x in first.split("-"))
    elif first == "VmFlags:" and low <= middle < high:
        flags = rest
print(json.dumps([flags, faults() - before]))
"""


def test_freed_memory_is_kept_in_large_pages():
    smaps = Path("/proc/self/smaps")
    if not smaps.exists() or "VmFlags" not in smaps.read_text():
        pytest.skip("the kernel tells no flags of memory")
    found = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True
    )
    flags, faults = json.loads(found.stdout)
    assert "hg" in flags  # VM_HUGEPAGE
    assert faults < 2**26 / 4096  # the pages of one tensor, of the five
