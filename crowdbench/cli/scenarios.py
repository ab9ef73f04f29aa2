"""``crowdbench scenarios``: what there is to cross."""

from __future__ import annotations

from typing import TYPE_CHECKING

from crowdbench.cli.common import out

if TYPE_CHECKING:
    from crowdbench.scenario import Scenario


def scenarios() -> None:
    """List the scenarios with their numbers, tier by tier."""
    from rich.table import Table

    from crowdbench.scenario import load_scenario, scenario_names, scenario_tiers

    for tier in scenario_tiers():
        table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
        table.add_column(tier, no_wrap=True)
        for heading in ("arena m", "way m", "static", "people", "speed m/s", "goals", "react"):
            table.add_column(heading, justify="right", no_wrap=True)
        for name in scenario_names(tier):
            table.add_row(name, *_numbers(load_scenario(name)))
        out().print(table)
        out().print()
    out().print("static: obstacles; react: share of reactive pedestrians, who see the robot")


def _numbers(scenario: Scenario) -> list[str]:
    arena, people, robots = scenario.arena, scenario.pedestrians, scenario.robots
    walking = [
        f"{people.speed[0]:g}-{people.speed[1]:g}",
        people.goals.removesuffix("modal"),
        f"{people.reactive:.0%}",
    ]
    return [
        f"{arena.length:g} x {arena.width:g}",
        f"{robots.travel:g}" if robots.start is None or robots.goal is None else "",
        str(scenario.obstacles.count),
        str(people.count),
        *(walking if people.count else ["", "", ""]),
    ]
