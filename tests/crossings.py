"""Small recordings to be crossed, and scenarios of them."""

import numpy as np

from crowdbench import load_scenario

FPS = 10


def walking(persons=6, seconds=30, speed=1.0, every=3.0):
    """People who walk along x one after another, in two rows, 12 m each, as a CSV."""
    lines = ["id,time [s],x [m],y [m]"]
    for person in range(persons):
        for frame in range(int(12 / speed * FPS) + 1):
            time = every * person + frame / FPS
            if time <= seconds:
                x, y = speed * frame / FPS - 6, 0.6 * (person % 2)
                lines.append(f"{person},{time:.2f},{x:.4f},{y + 0.05 * np.sin(x):.4f}")
    return "\n".join(lines) + "\n"


def standing(*places, seconds=30):
    """People who stand at places (x, y) [m] all the time, as a CSV."""
    lines = ["id,time [s],x [m],y [m]"]
    for person, (x, y) in enumerate(places):
        lines += [f"{person},{k / 2},{x + 0.1 * (k % 2)},{y}" for k in range(2 * seconds)]
    return "\n".join(lines) + "\n"


def crossing(path, **changes):
    """A scenario whose people walk by a file."""
    settings = {
        "pedestrians.model": "recorded",
        "pedestrians.recording.file": str(path),
        "robots.travel": 6.0,
        "time_limit": 12.0,
        **changes,
    }
    return load_scenario("multimodal_fast", **settings)
