"""``crowdbench export-onnx``: an agent's network for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from crowdbench.agent import AgentSpec
from crowdbench.cli.common import UserError, out


def export_onnx(
    agent: Annotated[str, typer.Argument(help="NAME[:OPTION=VALUE,...] or FILE.py:CLASS.")],
    file: Annotated[Path, typer.Argument(help="File to write.")],
) -> None:
    """Write the network that an agent acts by as an ONNX file."""
    spec = AgentSpec.parse(agent)
    made = spec.make()
    export = getattr(made, "export_onnx", None)
    if export is None:
        raise UserError(f"agent {str(spec)!r} has no method export_onnx: nothing to export")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        export(file)
    except ValueError as error:
        raise UserError(f"agent {str(spec)!r}: {error}") from error
    except OSError as error:
        raise UserError(f"{file}: cannot be written ({error.strerror or error})") from error
    out().print(f"{file}: {spec}", markup=False, soft_wrap=True)
