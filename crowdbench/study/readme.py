"""results/README.md: tables, figures, where we differ from the paper, and how it was measured."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from crowdbench.evaluation.metrics import METRICS
from crowdbench.study.claims import NO_LOSS, Finding, Order, check_claims, check_orders
from crowdbench.study.figures import DRAWINGS
from crowdbench.study.formats import escape_markdown, interval, markdown, paper, value
from crowdbench.study.measurements import Difference, Measurements
from crowdbench.study.sessions import Session
from crowdbench.study.tables import SIGNIFICANCE, Entry, Filled

_VERDICTS = ("holds", "fails", "undecided", "not yet run")
_INTRODUCTION = """\
# Results

Made by `python paper_tables.py` from the episodes in [episodes](episodes); changes by hand are
lost at the next run. `python paper_tables.py --run` runs what is missing first.
"""

_READING = """\
## How to read this

- The paper's scenarios are not published: neither the sizes of its arenas and robot, nor how many
  people there are, how fast they walk and how they evade, nor its weights. Ours are in
  [scenarios](../scenarios). So a value that differs from the paper's may differ because of the
  scenario, and orders of methods tell more than values. The paper's numbers are shown beside ours
  and used for nothing else.
- Every method meets the same people doing the same things: episodes are numbered by their seed, 0
  to 499, or 0 to 99 for planners that plan anew at every step. Methods are compared seed by seed.
- Intervals are 95 %: Wilson for success, BCa bootstrap for the rest. Tests are paired permutation
  tests, corrected after Holm over each table. [docs/metrics.md](../docs/metrics.md) defines every
  metric.
- Straight line is the floor, what one gets without planning. Informed knows everybody's position,
  speed and intention and is the ceiling, not a competitor.
- The paper timed inference on a GPU, we on the processor named below, one thread per planner.
- Ours and the TD-MPC-style planner search as their weights say, with fewer candidates than in the
  paper and another score ([docs/decisions.md](../docs/decisions.md)). How each learned
  agent was trained is in its card in [agents](../agents).
"""


def write_readme(
    tables: Sequence[Filled],
    measured: Measurements,
    figures: Mapping[str, bool],
    sessions: Sequence[Session],
) -> str:
    """The page as Markdown; the same results give the same bytes.

    Args:
        tables: all tables, filled.
        measured: what they were filled from.
        figures: for each figure's name whether there is one.
        sessions: when the episodes were run.
    """
    return "\n".join(
        [
            _INTRODUCTION,
            _state(tables, measured),
            _READING,
            _differences(tables, measured),
            "## Tables\n",
            *(_table(filled) for filled in tables),
            "## Figures\n",
            *_figures(figures),
            _provenance(measured, sessions),
        ]
    )


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
    for state, words in (("missing", "not yet run"), ("partial", "run in part")):
        if states[state]:
            text += f" {states[state]} of {states.total()} table cells are {words}."
    return text + "\n"


def _differences(tables: Sequence[Filled], measured: Measurements) -> str:
    findings = check_claims(measured)
    parts = [
        "## Where we differ from the paper\n",
        "### Claims\n",
        _tally(finding.verdict for finding in findings)
        + f" A claim holds or fails if the paired difference is significant (p < {SIGNIFICANCE:g} "
        "after Holm over the claims of its table) in or against its direction. Undecided is not "
        "refuted: the episodes do not tell. Differences are first less second; for *halves* the "
        f"second counts half, for *costs no success* {NO_LOSS:g} is taken off it.\n",
        *_rows(
            ("Claim", "Table", "Difference [95 %]", "p", "Verdict"), map(_finding_row, findings)
        ),
        "\n### Orders of methods\n",
        "Every pair of methods that a column of the paper puts in an order, tested on the seeds "
        f"that both ran (p < {SIGNIFICANCE:g} after Holm over all pairs of the table).\n",
        *_orders(check_orders(tables, measured)),
        "\n### Values\n",
        *_values(tables),
    ]
    return "\n".join([*parts, ""])


def _finding_row(finding: Finding) -> list[str]:
    verdict = finding.verdict
    return [
        escape_markdown(finding.claim.text),
        finding.claim.source,
        _difference(finding.difference, finding.claim.metric),
        _p(finding.p),
        f"**{verdict}**" if verdict in ("holds", "fails") else verdict,
    ]


def _orders(orders: Sequence[Order]) -> list[str]:
    numbers = list(dict.fromkeys(order.table.number for order in orders))
    counts: Counter[tuple[str, str]] = Counter(
        (order.table.number, order.verdict) for order in orders
    )
    lines = _rows(
        ("Table", *_VERDICTS),
        ([n, *(str(counts[n, verdict]) for verdict in _VERDICTS)] for n in numbers),
    )
    failed = [order for order in orders if order.verdict == "fails"]
    if not failed:
        return [*lines, "\nNone fails."]
    rows = (
        [
            order.table.number,
            escape_markdown(order.better.block.heading),
            METRICS[order.better.quantity.metric].better,
            escape_markdown(order.better.quantity.heading),
            escape_markdown(order.better.method.label),
            escape_markdown(order.worse.method.label),
            _difference(order.difference, order.better.quantity.metric),
            _p(order.p),
        ]
        for order in failed
    )
    heads = ("Table", "Scenario", "Better is", "Metric", "Paper's better", "Paper's worse",
             "Difference [95 %]", "p")  # fmt: skip
    return [*lines, "\nThose that fail:\n", *_folded(f"{len(failed)} orders", _rows(heads, rows))]


def _values(tables: Sequence[Filled]) -> list[str]:
    entries = [(filled.table, entry) for filled in tables for entry in filled.entries]
    known = [entry for _, entry in entries if entry.paper is not None and entry.estimate.n > 1]
    apart = [(table, entry) for table, entry in entries if entry.excludes_paper]
    lines = [
        f"The interval of {len(apart)} of {len(known)} measured cells excludes the paper's value "
        "(all that round to it). The paper gives no intervals; its own values, from 100 runs, are "
        "uncertain too.\n"
    ]
    if not apart:
        return lines
    rows = (
        [
            table.number,
            escape_markdown(entry.block.heading),
            escape_markdown(entry.method.label),
            escape_markdown(entry.quantity.heading),
            _ours(entry),
            paper(entry).strip("()"),
            _direction(entry),
        ]
        for table, entry in apart
    )
    heads = ("Table", "Scenario", "Method", "Metric", "Here", "Paper", "Here it is")
    return [*lines, *_folded(f"{len(apart)} cells", _rows(heads, rows))]


def _direction(entry: Entry) -> str:
    """Whether our value is better or worse than the paper's."""
    assert entry.paper is not None
    higher = entry.estimate.mean > entry.paper
    return "better" if higher == (METRICS[entry.quantity.metric].better == "higher") else "worse"


def _ours(entry: Entry) -> str:
    return f"{value(entry)} {interval(entry)}"


def _table(filled: Filled) -> str:
    table = filled.table
    name = f"table_{table.number}"
    links = f"[CSV](tables/{name}.csv), [LaTeX](tables/{name}.tex)"
    title = escape_markdown(table.title)
    return f"### Table {table.number}: {title}\n\n{markdown(filled)}\n{links}\n"


def _figures(there: Mapping[str, bool]) -> list[str]:
    lines = []
    for drawing in DRAWINGS:
        lines.append(f"### {drawing.title}\n")
        if there.get(drawing.name):
            image = f'<img src="figures/{drawing.name}.png" width="500" alt="{drawing.title}">'
            lines.append(f"{image}\n\n{drawing.caption} [PDF](figures/{drawing.name}.pdf)\n")
        else:
            lines.append(f"Not yet run. {drawing.caption}\n")
    return lines


def _provenance(measured: Measurements, sessions: Sequence[Session]) -> str:
    rows = measured.episodes
    lines = ["## How this was measured\n"]
    if len(rows):
        planning = float(np.nansum(rows["inference_s"] * rows["steps"]))
        lines += [
            f"- Machines: {_counted(rows['machine'])}.",
            f"- crowdbench: {_counted(rows['version'])}.",
            f"- Time inside the agents, over all episodes: {duration(planning)}.",
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
        lines.append("- Total run time: not yet known; `--run` keeps account of it.")
    weights = rows[rows["weights_sha256"] != ""].groupby("weights_sha256", sort=True)["agent"]
    users = {digest: sorted(set(agents)) for digest, agents in weights}
    if users:
        listed = ([f"`{digest}`", ", ".join(map(escape_markdown, users[digest]))]
                  for digest in sorted(users, key=users.__getitem__))  # fmt: skip
        lines += ["\nWeights:\n", *_rows(("SHA-256", "Agents"), listed)]
        mixed = [
            agent
            for agent in sorted({agent for agents in users.values() for agent in agents})
            if sum(agent in agents for agents in users.values()) > 1
        ]
        if mixed:
            lines.append(
                f"\nMore than one set of weights in use: {', '.join(map(escape_markdown, mixed))}. "
                "`--run` brings the older episodes up to date."
            )
    return "\n".join([*lines, ""])


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


def _tally(verdicts: Iterable[str]) -> str:
    counts = Counter(verdicts)
    told = ", ".join(f"{name} {counts[name]}" for name in _VERDICTS if counts[name])
    return f"Of {counts.total()} claims: {told}."


def _difference(difference: Difference, metric: str) -> str:
    """With the digits that the metric deserves."""
    if np.isnan(difference.mean):
        return ""
    scale, unit, digits = {"inference_s": (1000, " ms", 2)}.get(metric, (1, "", 3))
    numbers = [f"{scale * x:+.{digits}f}" for x in difference[:3]]
    return f"{numbers[0]}{unit} [{numbers[1]}, {numbers[2]}]"


def _p(p: float) -> str:
    return "" if np.isnan(p) else "< 0.001" if p < 0.001 else f"{p:.3f}"


def _folded(summary: str, lines: Sequence[str]) -> list[str]:
    """Lines that GitHub shows on a click."""
    return ["<details>", f"<summary>{summary}</summary>\n", *lines, "\n</details>"]


def _rows(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return [f"| {' | '.join(line)} |" for line in lines]
