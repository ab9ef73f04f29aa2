"""Running agents through episodes and turning the logs into numbers."""

import sys

if sys.platform == "win32":
    raise ImportError(
        "crowdbench runs agents on Linux and macOS only, for lack of process groups and signals "
        "elsewhere; on Windows use the Windows Subsystem for Linux"
    )
