"""``crowdbench agents`` and ``crowdbench scenarios``: what there is."""

from __future__ import annotations

import inspect

from crowdbench.cli_common import out


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


def scenarios() -> None:
    """List the scenarios with their numbers."""
    from rich.table import Table

    from crowdbench.scenario import load_scenario, scenario_names

    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("scenario", no_wrap=True)
    for heading in ("arena m", "way m", "static", "people", "speed m/s", "goals", "react"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name in scenario_names():
        scenario = load_scenario(name)
        arena, people = scenario.arena, scenario.pedestrians
        walking = [
            f"{people.speed[0]:g}-{people.speed[1]:g}",
            people.goals.removesuffix("modal"),
            f"{people.reactive:.0%}",
        ]
        table.add_row(
            name,
            f"{arena.length:g} x {arena.width:g}",
            f"{scenario.robots.travel:g}",
            str(scenario.obstacles.count),
            str(people.count),
            *(walking if people.count else ["", "", ""]),
        )
    console = out()
    console.print(table)
    console.print("\nstatic: obstacles; react: share of the people who see the robot")
