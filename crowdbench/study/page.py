"""A study's README.md: what holds, the tables and figures it shows, and how it was measured."""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd

from crowdbench.evaluation.scoring import TRUSTED_SHARE, waited
from crowdbench.study.claims import Finding, Order, Verdict
from crowdbench.study.formats import escape_markdown, legend, markdown_table
from crowdbench.study.measurements import Measurements
from crowdbench.study.model import Study
from crowdbench.study.sessions import Session
from crowdbench.study.tables import SIGNIFICANCE, Filled
from crowdbench.study.verdicts import judged, side

_VERDICTS: tuple[Verdict, ...] = ("holds", "fails", "undecided", "not yet run")


def write_page(
    study: Study,
    tables: Sequence[Filled],
    findings: Sequence[Finding],
    orders: Sequence[Order],
    measured: Measurements,
    figures: Mapping[str, bool],
    sessions: Sequence[Session],
) -> str:
    """The page as Markdown; the same results give the same bytes.

    Args:
        study: what the page is about.
        tables: all its tables, filled.
        findings, orders: what the episodes say about its claims and its reference's orders.
        measured: what all of this comes from.
        figures: for each figure's name whether there is one.
        sessions: when the episodes were run.
    """
    parts = [
        f"# {escape_markdown(study.title)}\n",
        study.introduction,
        _state(tables, measured),
        _findings(study, findings),
        _reference(study, tables, orders),
        _tables(study, tables),
        _figures(study, figures),
        study.reading,
        _provenance(measured, sessions),
    ]
    return "\n".join(part.rstrip("\n") + "\n" for part in parts if part)


def duration(seconds: float) -> str:
    """A time as people say it: ``2 h 05 min``, ``7 min``, ``40 s``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


def _state(tables: Sequence[Filled], measured: Measurements) -> str:
    planned = sum(cell.episodes for cell in measured.plan)
    states: Counter[str] = Counter(entry.state for filled in tables for entry in filled.entries)
    text = f"{len(measured.episodes):,} of {planned:,} planned episodes are stored."
    for state, words in (
        ("missing", "not yet run"),
        ("not computed", "not computed"),
        ("partial", "run in part"),
    ):
        if states[state]:
            text += f" {states[state]} of {states.total()} table cells are {words}."
    return text


def _findings(study: Study, findings: Sequence[Finding]) -> str:
    """A line per table: which of its claims hold, fail or are undecided."""
    if not findings:
        return ""
    counts = Counter(finding.verdict for finding in findings)
    told = ", ".join(f"{name} {counts[name]}" for name in _VERDICTS if counts[name])
    columns = [verdict for verdict in _VERDICTS if verdict != "not yet run" or counts[verdict]]
    rows = []
    for table in study.tables:
        here = [finding for finding in findings if finding.claim.table == table.number]
        if here:
            cells = ("; ".join(_texts(study, here, verdict)) for verdict in columns)
            rows.append([table.number, *cells])
    undefined = ""
    if any(finding.undefined for finding in findings):
        undefined = " Undefined: in no episode that both ran has the metric a value for both."
    return "\n".join(
        [
            "## What holds\n",
            f"Of {len(findings)} claims: {told} ([claims.csv](tables/claims.csv)). A claim holds "
            f"or fails if the paired difference is significant (p < {SIGNIFICANCE:g} after Holm "
            "over the claims of its table) in or against its direction. Undecided is not refuted: "
            f"the episodes do not tell.{undefined}\n",
            *_rows(("Table", *(verdict.capitalize() for verdict in columns)), rows),
        ]
    )


def _texts(study: Study, findings: Sequence[Finding], verdict: Verdict) -> list[str]:
    """Claims with a verdict; those that share their text stand together, with their metrics."""
    headings = {q.metric: q.heading for table in study.tables for q in table.quantities}
    texts = dict.fromkeys(finding.claim.text for finding in findings)
    told = []
    for text in texts:
        same = [finding for finding in findings if finding.claim.text == text]
        here = [finding for finding in same if finding.verdict == verdict]
        metrics = [
            headings.get(finding.claim.metric, finding.claim.metric)
            + (": undefined" if finding.undefined else "")
            for finding in here
        ]
        if metrics:
            plain = len(same) == 1 and not here[0].undefined
            told.append(text if plain else f"{text} ({', '.join(metrics)})")
    return list(map(escape_markdown, told))


def _reference(study: Study, tables: Sequence[Filled], orders: Sequence[Order]) -> str:
    """How orders and values compare with the reference, if there is one."""
    entries = [entry for filled in tables for entry in judged(filled)]
    if not any(filled.source for filled in tables):
        return ""
    counts = Counter(order.verdict for order in orders)
    told = ", ".join(f"{name} {counts[name]}" for name in _VERDICTS if counts[name]) or "none"
    sides = Counter(map(side, entries))
    return "\n".join(
        [
            f"## Where we differ from {study.source}\n",
            f"- Orders of two methods in a column of {study.source}: {told}, tested like the "
            "claims ([orders.csv](tables/orders.csv)).",
            f"- Values: of {len(entries)} measured cells, the interval of "
            f"{sides['better'] + sides['worse']} excludes {study.source}'s value and all that "
            f"round to it; {sides['better']} are better here, {sides['worse']} worse "
            "([differences.csv](tables/differences.csv)).",
        ]
    )


def _tables(study: Study, tables: Sequence[Filled]) -> str:
    if not tables:
        return ""
    shown = [filled for filled in tables if not study.shown or filled.table.number in study.shown]
    parts = ["## Tables\n"]
    if shown:
        notes = dict.fromkeys(note for filled in shown for note in legend(filled))
        parts.append(" ".join(map(escape_markdown, notes)) + "\n")
    for filled in shown:
        table = filled.table
        parts.append(f"### Table {table.number}: {escape_markdown(table.title)}\n")
        parts.append(markdown_table(filled))
        note = f"{escape_markdown(table.note)} " if table.note else ""
        name = f"tables/table_{table.number}"
        parts.append(f"{note}[CSV]({name}.csv), [LaTeX]({name}.tex)\n")
    others = [filled.table for filled in tables if filled not in shown]
    if others:
        links = (
            f"[{table.number}](tables/table_{table.number}.md) {escape_markdown(table.title)}"
            for table in others
        )
        parts.append(f"The other tables: {'; '.join(links)}.\n")
    return "\n".join(parts)


def _figures(study: Study, there: Mapping[str, bool]) -> str:
    if not study.figures:
        return ""
    parts, others = ["## Figures\n"], []
    for drawing in study.figures:
        pdf = f"figures/{drawing.name}.pdf"
        if not there.get(drawing.name):
            others.append(f"{escape_markdown(drawing.title)} (not yet run)")
        elif study.shown and drawing.name not in study.shown:
            others.append(f"[{escape_markdown(drawing.title)}]({pdf})")
        else:
            title = html.escape(drawing.title)
            image = f'<img src="figures/{drawing.name}.png" width="500" alt="{title}">'
            caption = f"{escape_markdown(drawing.title)}. {drawing.caption} [PDF]({pdf})"
            parts.append(f"{image}\n\n{caption}\n")
    if others:
        parts.append(f"The other figures: {', '.join(others)}.\n")
    return "\n".join(parts)


def _untimed(rows: pd.DataFrame) -> list[str]:
    """A line on the episodes whose times do not count, if there are any."""
    count = int(waited(rows).sum())
    return [
        f"- Without a time: {count:,} episodes, in which the process computed for less than "
        f"{TRUSTED_SHARE:.0%} of its time inside the agent (the machine was overloaded, or the "
        "agent waits for something)."
    ] * (count > 0)


def _provenance(measured: Measurements, sessions: Sequence[Session]) -> str:
    rows = measured.episodes
    lines = ["## How this was measured\n"]
    if len(rows):
        planning = float(np.nansum(rows["inference_s"] * rows["steps"]))
        lines += [
            f"- Machines: {_counted(rows['machine'])}.",
            f"- crowdbench: {_counted(rows['version'])}.",
            f"- Time inside the agents, over the episodes that have a time: {duration(planning)}.",
            *_untimed(rows),
            f"- Episodes that an error of the agent ended (they count as failures): "
            f"{_failures(measured)}.",
        ]
    if sessions:
        total, episodes = sum(s.seconds for s in sessions), sum(s.episodes for s in sessions)
        versions = {f"{k} {v}": None for s in sessions for k, v in s.versions.items()}
        jobs = ", ".join(str(number) for number in sorted({s.jobs for s in sessions}))
        gone = episodes - len(rows)
        dropped = f" ({gone:,} of them no longer stored)" if gone > 0 else ""
        lines += [
            f"- Total run time: {duration(total)} for {episodes:,} episodes{dropped} in "
            f"{len(sessions)} sessions with {jobs} processes.",
            f"- Software: {escape_markdown(', '.join(versions))}.",
        ]
    else:
        lines.append(
            "- Total run time: not recorded here; `--run` keeps that of the episodes it runs "
            "beside them, in `sessions/`."
        )
    weights = rows[rows["weights_sha256"] != ""].groupby("agent", sort=True)["weights_sha256"]
    sets = weights.nunique()
    if len(sets):
        lines.append("- Weights: [weights.csv](tables/weights.csv).")
        mixed = [str(agent) for agent in sets[sets > 1].index]
        if mixed:
            lines.append(
                f"\nMore than one set of weights in use: {', '.join(map(escape_markdown, mixed))}. "
                "`--run` brings the older episodes up to date."
            )
    return "\n".join(lines)


def _failures(measured: Measurements) -> str:
    failed = measured.episodes[measured.episodes["outcome"] == "agent_error"]
    if failed.empty:
        return "none"
    return f"{len(failed)} ({_counted(failed['agent'])})"


def _counted(values: Sequence[str]) -> str:
    counts = sorted(Counter(values).items())
    if len(counts) == 1:
        return escape_markdown(counts[0][0])
    return ", ".join(f"{escape_markdown(name)} ({count:,} episodes)" for name, count in counts)


def _rows(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return [f"| {' | '.join(line)} |" for line in lines]
