"""Networks learn in bfloat16 where that is asked for and the CPU is fast at it."""

import os
import subprocess
import sys

from crowdbench_agents.learning import precision


def test_what_was_chosen_is_said(instructions):
    said = precision.describe_precision(True)
    assert said.startswith("bfloat16" if instructions else "float32 (this CPU has no instructions")
    assert precision.describe_precision(False) == "float32"


def test_bfloat16_is_not_used_where_onednn_may_not_use_it():
    code = (
        "import sys; from crowdbench_agents.learning.precision import cpu_has_bfloat16; "
        "sys.exit(cpu_has_bfloat16())"
    )
    environment = {**os.environ, "ONEDNN_MAX_CPU_ISA": "AVX2"}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
