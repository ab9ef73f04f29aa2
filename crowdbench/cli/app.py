"""The ``crowdbench`` command.

Everything heavy is imported inside the commands, so that ``crowdbench --help`` answers at once.
"""

from __future__ import annotations

import codecs
import io
import sys
import warnings
from collections.abc import Sequence
from typing import Annotated, TextIO

import typer

from crowdbench.agent import AgentError
from crowdbench.call_stack import with_room
from crowdbench.cli.agents import agents
from crowdbench.cli.common import UserError, err, out
from crowdbench.cli.compare import compare
from crowdbench.cli.export_minari import export_minari
from crowdbench.cli.export_onnx import export_onnx
from crowdbench.cli.merge import merge
from crowdbench.cli.people import people
from crowdbench.cli.play import play
from crowdbench.cli.publish import publish
from crowdbench.cli.recompute import recompute
from crowdbench.cli.record import record
from crowdbench.cli.replay import replay
from crowdbench.cli.report import report
from crowdbench.cli.run import run
from crowdbench.cli.scenarios import scenarios
from crowdbench.cli.show import show
from crowdbench.cli.tables import tables
from crowdbench.cli.train import train
from crowdbench.cli.transfer import export, import_results
from crowdbench.evaluation.database import ResultsError
from crowdbench.evaluation.executors import ExecutorError
from crowdbench.evaluation.metric import MetricError
from crowdbench.registry import UnknownNameError
from crowdbench.scenario import ScenarioError

app = typer.Typer(
    help="Measure robot planners among people.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (
    run, compare, agents, scenarios, show, record, play, train, tables, report, replay, recompute,
    export, export_minari, export_onnx, merge, publish, people,
):  # fmt: skip
    app.command()(command)
app.command("import")(import_results)


_IN_ASCII = "crowdbench.in_ascii"
_SIGNS = {"↑": "^", "↓": "v", "—": "-", "–": "-", "†": "+", "²": "2", "³": "3", "·": "*", "…": "."}
"""What stands for our signs where the encoding lacks them; each as wide as the sign."""


def _in_ascii(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    return "".join(_SIGNS.get(sign, "?") for sign in lacking), error.end


codecs.register_error(_IN_ASCII, _in_ascii)


@with_room
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; the user's mistakes become one red line and exit code 2."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_IN_ASCII)  # a terminal may know nothing but ASCII
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            app(args=None if arguments is None else list(arguments), prog_name="crowdbench")
    except SystemExit as ending:
        return ending.code if isinstance(ending.code, int) else int(ending.code is not None)
    except (
        UserError, ScenarioError, AgentError, ResultsError, MetricError, ExecutorError,
        UnknownNameError,
    ) as error:  # fmt: skip
        console = err()
        console.print(" ".join(str(error).split()), style="bold red", markup=False, soft_wrap=True)
        return 2
    return 0


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """A warning as one yellow line, without the place in the code."""
    text = " ".join(f"warning: {message}".split())
    err().print(text, style="yellow", markup=False, soft_wrap=True)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        out().print(f"crowdbench {version('crowdbench-nav')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    pass
