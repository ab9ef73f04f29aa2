"""``crowdbench scenarios``: what there is to cross."""

from __future__ import annotations

from crowdbench.cli.common import out


def scenarios() -> None:
    """List the scenarios with their numbers, tier by tier."""
    from rich.table import Table

    from crowdbench.scenario import load_scenario, scenario_names, scenario_tiers

    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for heading in ("scenario", "tier"):
        table.add_column(heading, no_wrap=True)
    for heading in ("arena m", "way m", "static", "people", "speed m/s", "goals", "react"):
        table.add_column(heading, justify="right", no_wrap=True)
    tiers = {name: tier for tier in scenario_tiers() for name in scenario_names(tier)}
    for name, tier in tiers.items():
        scenario = load_scenario(name)
        arena, people = scenario.arena, scenario.pedestrians
        walking = [
            f"{people.speed[0]:g}-{people.speed[1]:g}",
            people.goals.removesuffix("modal"),
            f"{people.reactive:.0%}",
        ]
        table.add_row(
            name,
            tier,
            f"{arena.length:g} x {arena.width:g}",
            f"{scenario.robots.travel:g}",
            str(scenario.obstacles.count),
            str(people.count),
            *(walking if people.count else ["", "", ""]),
        )
    console = out()
    console.print(table)
    console.print("\nstatic: obstacles; react: share of reactive pedestrians, who see the robot")
