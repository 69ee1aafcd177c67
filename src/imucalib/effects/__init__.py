"""The catalogue of effects: every module here that has `EFFECTS` contributes them.

A new effect is one new file in this folder, or any file of the user's with an `EFFECTS` tuple, or
an entry point of the group "imucal.effects".
"""

from __future__ import annotations

import importlib.util
import pkgutil
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from imucalib.effect import Effect
from imucalib.errors import UsageError


@cache
def catalogue() -> dict[str, Effect]:
    """All effects by name: this folder's first, then those of installed entry points."""
    found: dict[str, Effect] = {}
    for info in sorted(pkgutil.iter_modules(__path__), key=lambda m: m.name):
        module = importlib.import_module(f"{__name__}.{info.name}")
        _add(found, getattr(module, "EFFECTS", ()), f"effects/{info.name}.py")
    for point in entry_points(group="imucal.effects"):
        _add(found, point.load(), f"entry point {point.name}")
    return found


def load_file(path: Path) -> dict[str, Effect]:
    """The effects of a user's file; raises UsageError when the file has no `EFFECTS`."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise UsageError("not a Python file", where=str(path))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found: dict[str, Effect] = {}
    effects = getattr(module, "EFFECTS", ())
    if not effects:
        raise UsageError("no EFFECTS in it", where=str(path), remedy="define EFFECTS = (...,)")
    _add(found, effects, str(path))
    return found


def named(name: str) -> Effect:
    """One effect of the catalogue; raises UsageError with the nearest names."""
    import difflib

    effects = catalogue()
    if name not in effects:
        near = ", ".join(difflib.get_close_matches(name, effects, 3)) or ", ".join(effects)
        raise UsageError(f"no effect is called '{name}'", remedy=f"did you mean: {near}")
    return effects[name]


def _add(found: dict[str, Effect], effects: tuple[Effect, ...], where: str) -> None:
    for effect in effects:
        if effect.name in found:
            raise UsageError(f"two effects are called '{effect.name}'", where=where)
        found[effect.name] = effect
