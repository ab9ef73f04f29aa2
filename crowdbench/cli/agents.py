"""``crowdbench agents``: what can drive."""

from __future__ import annotations

import inspect

from crowdbench.cli.common import out


def agents() -> None:
    """List the installed agents with their options."""
    from rich.markup import escape
    from rich.table import Table

    from crowdbench.agent import AgentError, agent_names, agent_options, find_agent

    table = Table("agent", "what it is", "options = default", box=None, pad_edge=False)
    for name in agent_names():
        try:
            factory = find_agent(name)
        except AgentError as error:
            table.add_row(name, f"[red]{escape(str(error))}[/red]", "")
            continue
        summary = (inspect.getdoc(factory) or "").partition("\n")[0]
        options = [
            key if default is inspect.Parameter.empty else f"{key} = {default!r}"
            for key, default in agent_options(factory).items()
        ]
        table.add_row(name, escape(summary), escape(", ".join(options)))
    console = out()
    console.print(table)
    console.print("\nOne file is an agent too: --agent my_planner.py:MyPlanner")
