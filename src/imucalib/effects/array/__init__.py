"""The catalogue of an array's effects: every module here that has `EFFECTS` contributes them.

A new effect is one new file in this folder. `ABSORBED` ones cannot be seen in any motion: they are
computed to say what they would do to the positions.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from imucalib.core.array_motion import ArrayEffect


@cache
def array_catalogue() -> dict[str, ArrayEffect]:
    """All effects by name, in the order of the files."""
    found: dict[str, ArrayEffect] = {}
    for info in sorted(pkgutil.iter_modules(__path__), key=lambda m: m.name):
        module = importlib.import_module(f"{__name__}.{info.name}")
        for effect in getattr(module, "EFFECTS", ()):
            if effect.name in found:
                raise ValueError(f"two array effects are called '{effect.name}'")
            found[effect.name] = effect
    return found
