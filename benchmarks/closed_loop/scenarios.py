"""The trials of the acceptance benchmark, scenario by scenario, in a fixed order of seeds."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from itertools import count
from types import ModuleType

import numpy as np
from trial import Job

SIZES = (0.35, 1.0, 3.0)
WORLDS = {"lab": "lab_world", "actigraph": "week_world", "array": "array_world"}


def world(calibrator: str) -> ModuleType:
    """The generator of a calibrator: effects(), OUTSIDE, NOISE, FAULTS, CONFOUNDED, trial(job)."""
    return import_module(WORLDS[calibrator])


def jobs(calibrator: str, scale: float) -> Iterator[Job]:
    """All trials of a calibrator; `scale` multiplies their number (1 is the full benchmark)."""
    of = world(calibrator)
    seeds = count(1_000_000 * (1 + list(WORLDS).index(calibrator)))

    def many(number: int) -> range:
        return range(max(1, round(number * scale)))

    for _ in many(400):
        yield Job(calibrator, "clean", next(seeds))
    for kind in of.NOISE:
        for _ in many(100):
            yield Job(calibrator, f"noise: {kind}", next(seeds), noise=kind)
    names = of.effects()
    for name in names:
        for size in SIZES:
            for _ in many(300 // (len(names) * len(SIZES)) + 3):
                yield Job(calibrator, "one effect", next(seeds), ((name, size),))
    draw = np.random.default_rng(5)
    for _ in many(120):
        pair = draw.choice(len(names), 2, replace=False)
        planted = tuple((names[k], 1.0) for k in pair)
        yield Job(calibrator, "two effects", next(seeds), planted)
    for name in of.OUTSIDE:
        for size, words in ((1.0, "weak"), (3.0, "strong")):
            for _ in many(30):
                yield Job(calibrator, f"outside, {words}", next(seeds), outside=(name, size))
    for name, layout, size in of.CONFOUNDED:
        for _ in many(40):
            yield Job(calibrator, "confounded", next(seeds), ((name, size),), layout=layout)
    for fault in of.FAULTS:
        for _ in many(60):
            yield Job(calibrator, f"fault: {fault}", next(seeds), fault=fault)
