"""A filled table as Markdown, LaTeX, CSV and for the terminal."""

from __future__ import annotations

import csv
import io
import math
import re

from rich import box
from rich.console import Group
from rich.table import Table as TerminalTable
from rich.text import Text

from crowdbench.evaluation.metrics import METRICS
from crowdbench.study.model import Quantity
from crowdbench.study.tables import Entry, Filled

_CELL_WIDTH = len("[0.00, 0.00]")
_ZERO = 1e-12
"""What is smaller is rounding, and differs from processor to processor."""
MISSING, UNDEFINED, NOT_COMPUTED, PARTIAL = "—", "undefined", "not computed", "†"

_COLUMNS = (
    "table", "block", "scenarios", "method", "agent", "metric", "unit", "episodes", "planned",
    "defined", "value", "low", "high", "reference", "bold", "p_against_best",
)  # fmt: skip
_LATEX = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "&": r"\&", "%": r"\%", "$": r"\$",
    "#": r"\#", "_": r"\_", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", '"': "{''}",
    "[": "{[}", "]": "{]}", "—": "---", "†": r"\dag{}", "↑": r"$\uparrow$", "↓": r"$\downarrow$",
    "²": r"\textsuperscript{2}", "³": r"\textsuperscript{3}",
}  # fmt: skip


def csv_text(filled: Filled) -> str:
    """One line per entry, numbers in the stored unit with six significant digits."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for entry in filled.entries:
        metric, estimate = entry.quantity.metric, entry.estimate
        numbers = (estimate.mean, estimate.low, estimate.high, entry.reference)
        writer.writerow(
            [
                filled.table.number,
                entry.block.heading,
                " ".join(entry.block.scenarios),
                entry.method.label,
                entry.method.agent,
                metric,
                METRICS[metric].unit,
                entry.episodes,
                entry.planned,
                estimate.n,
                *map(digits, numbers),
                "yes" if entry.bold else "",
                digits(entry.p),
            ]
        )
    return buffer.getvalue()


def markdown(filled: Filled) -> str:
    """A table for GitHub, with what has to be known beneath it."""
    beneath = " ".join(escape_markdown(note) for note in notes(filled))
    return f"{markdown_table(filled)}\n{beneath}\n"


def markdown_table(filled: Filled) -> str:
    """A table for GitHub."""
    table = filled.table
    rows = [["Method", *map(_heading, table.quantities)]]
    rows.append(["---"] + ["---:"] * len(table.quantities))
    for block in table.blocks:
        if block.heading:
            rows.append([f"*{escape_markdown(block.heading)}*"] + [""] * len(table.quantities))
        for method in table.methods:
            cells = [_markdown_cell(entry) for entry in filled.row(block, method)]
            rows.append([escape_markdown(method.label), *cells])
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([*lines, ""])


def latex(filled: Filled) -> str:
    """A table of one column's width for booktabs; intervals stand below their values."""
    table = filled.table
    columns = len(table.quantities) + 1
    lines = [
        r"\begin{table}[t]",
        rf"\caption{{{escape_latex(table.title)}}}",
        rf"\label{{tab:{table.number.lower()}}}",
        r"\centering\scriptsize\setlength{\tabcolsep}{3pt}",
        rf"\begin{{tabular}}{{l{'r' * (columns - 1)}}}",
        r"\toprule",
        " & ".join(["Method", *(escape_latex(_heading(q)) for q in table.quantities)]) + r" \\",
    ]
    for block in table.blocks:
        lines.append(r"\midrule")
        if block.heading:
            heading = escape_latex(block.heading)
            lines.append(rf"\multicolumn{{{columns}}}{{l}}{{\emph{{{heading}}}}} \\")
        for method in table.methods:
            entries = filled.row(block, method)
            above = [escape_latex(method.label), *map(_latex_value, entries)]
            below = ["", *(rf"{{\tiny {escape_latex(interval(e))}}}" for e in entries)]
            lines += [" & ".join(above) + r" \\", " & ".join(below) + r" \\"]
    lines += [r"\bottomrule", r"\end{tabular}", ""]
    lines += [rf"\smallskip\raggedright {' '.join(map(escape_latex, notes(filled)))}"]
    return "\n".join([*lines, r"\end{table}", ""])


def terminal(filled: Filled) -> Group:
    """A table for rich, 80 columns wide with five quantities."""
    shown = TerminalTable(
        title=Text(f"Table {filled.table.number}: {filled.table.title}", style="bold"),
        box=box.SIMPLE_HEAD,
        title_justify="left",
        padding=0,
        show_edge=False,
    )
    shown.add_column("Method")
    for quantity in filled.table.quantities:
        shown.add_column(Text(_heading(quantity)), justify="right", min_width=_CELL_WIDTH)
    for block in filled.table.blocks:
        if block.heading:
            shown.add_row(Text(block.heading, style="italic"))
        for method in filled.table.methods:
            cells = []
            for entry in filled.row(block, method):
                cell = Text(value(entry), style="bold" if entry.bold else "")
                cell.append(f" {reference(entry)}", style="not bold")
                if within := interval(entry):
                    cell.append(f"\n{within}", style="not bold")
                cells.append(cell)
            shown.add_row(Text(method.label), *cells)
        shown.add_section()
    return Group(shown, Text(" ".join(notes(filled)), style="dim"))


def notes(filled: Filled) -> list[str]:
    """What a reader has to know to read the table."""
    return [*legend(filled), filled.table.note] if filled.table.note else legend(filled)


def legend(filled: Filled) -> list[str]:
    """What the signs in a table mean, a sentence each."""
    states = filled.states()
    numbers = states - {"missing", "not computed"}
    measured = "Value [95 % interval]" if numbers else "Measured value"
    written = [f"{measured} ({filled.source}'s value)." if filled.source else f"{measured}."]
    if any(entry.bold for entry in filled.entries):
        written.append(
            "Bold: the best of a column and those that cannot be told from it (paired permutation "
            "tests, Holm over the table, p < 0.05), if any other can; floor and ceiling aside."
        )
    if "missing" in states:
        written.append(f"{MISSING}: not yet run.")
    if "partial" in states:
        written.append(
            f"{PARTIAL}: only some of the planned episodes were run so far, or with this metric."
        )
    if "undefined" in states:
        written.append(f"{UNDEFINED}: in no episode is this metric defined.")
    if "not computed" in states:
        written.append(
            f"{NOT_COMPUTED}: the episodes are older than this metric; crowdbench recompute "
            "fills it in."
        )
    return written


def value(entry: Entry) -> str:
    """The measured value as printed, or what stands in its place."""
    if entry.state == "missing":
        return MISSING
    if entry.state == "undefined":
        return UNDEFINED
    if entry.state == "not computed":
        return NOT_COMPUTED
    number = _printed(entry, entry.estimate.mean)
    return number + PARTIAL if entry.state == "partial" else number


def interval(entry: Entry) -> str:
    """The interval as printed, empty where there is none."""
    if math.isnan(entry.estimate.low):
        return ""
    low, high = (_printed(entry, limit) for limit in (entry.estimate.low, entry.estimate.high))
    return f"[{low}, {high}]"


def reference(entry: Entry) -> str:
    """The reference value as printed, empty where there is none."""
    if entry.reference is None:
        return ""
    printed = entry.quantity.printed
    if printed.digits is None:
        return f"({entry.reference * printed.scale:.3g})"
    return f"({printed.number(entry.reference)})"


def escape_markdown(text: str) -> str:
    """Text that Markdown, with HTML and inside a table, shows as it is."""
    line = " ".join(text.split())
    line = line.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"([\\`*_{}\[\]|~#])", r"\\\1", line)


def escape_latex(text: str) -> str:
    """Text that LaTeX shows as it is."""
    return "".join(_LATEX.get(character, character) for character in " ".join(text.split()))


def _heading(quantity: Quantity) -> str:
    return f"{quantity.heading} {quantity.printed.arrow}"


def _markdown_cell(entry: Entry) -> str:
    number = f"**{value(entry)}**" if entry.bold else value(entry)
    limits = interval(entry)
    return " ".join(filter(None, [number, limits, reference(entry)]))


def _latex_value(entry: Entry) -> str:
    number = escape_latex(value(entry))
    number = rf"\textbf{{{number}}}" if entry.bold else number
    return " ".join(filter(None, [number, escape_latex(reference(entry))]))


def _printed(entry: Entry, number: float) -> str:
    """A number in the printed unit; its decimals follow from the mean, also in the interval."""
    return entry.quantity.printed.number(number, beside=entry.estimate.mean)


def digits(number: float | None) -> str:
    """A number in a CSV file: six significant digits, empty where there is none."""
    if number is None or math.isnan(number):
        return ""
    return f"{0.0 if abs(number) < _ZERO else number:.6g}"
