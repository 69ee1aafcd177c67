"""The catalogue of effects: every module here that has `EFFECTS` contributes them.

A new effect is one new file in this folder, or any file of the user's with an `EFFECTS` tuple, or
an entry point of the group "imucal.effects".
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from imucalib.core.discovery import modules_of
from imucalib.core.effect import Effect, EffectScan
from imucalib.effects.contract import check_effects
from imucalib.errors import UsageError
from imucalib.file_hash import sha256_of

#: Effects of files that this process has loaded; a calibration may need them to be applied.
_LOADED: dict[str, Effect] = {}
#: Where each of them comes from: the file's name and its SHA-256.
_FILES: dict[str, tuple[str, str]] = {}


def catalogue() -> dict[str, Effect]:
    """All effects by name: this folder's, those of installed entry points, and loaded files'."""
    return {**_load_plugins(), **_LOADED}


@cache
def _load_plugins() -> dict[str, Effect]:
    found: dict[str, Effect] = {}
    for module in modules_of(__name__):
        _add(found, getattr(module, "EFFECTS", ()), module.__name__)
    for point in entry_points(group="imucal.effects"):
        _add(found, point.load(), f"entry point {point.name}")
    return found


@cache
def families() -> dict[str, EffectScan]:
    """Scans by name: modules of this room that have `FAMILIES` contribute them."""
    found: dict[str, EffectScan] = {}
    for module in modules_of(__name__):
        found.update({f.name: f for f in getattr(module, "FAMILIES", ())})
    return found


def known(name: str) -> Effect | None:
    """An effect by name, be it of the catalogue or one of a family ("bias_step@86400s")."""
    family, at, value = name.partition("@")
    if at and family in families():
        try:
            return families()[family].member(value)
        except ValueError:
            return None
    return catalogue().get(name)


def names_a_cause(name: str) -> bool:
    """Whether an effect of this name is a cause, and no free function or form."""
    family = families().get(name.partition("@")[0])
    return family is None or not family.free


def load_file(path: Path) -> dict[str, Effect]:
    """Add the effects of a user's file to the catalogue.

    Raises UsageError when there is no such file, it fails, it has no `EFFECTS`, one of them is no
    effect (`contract`), or a name is taken.
    """
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise UsageError("not a Python file", where=str(path))
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # the file is the user's: whatever it raises is theirs to mend
        raise UsageError(
            f"it fails with {type(error).__name__}: {error}", where=str(path)
        ) from error
    found = dict(_load_plugins())
    effects = check_effects(getattr(module, "EFFECTS", ()), str(path))
    _add(found, effects, str(path))
    own = {effect.name: effect for effect in effects}
    _LOADED.update(own)
    _FILES.update(dict.fromkeys(own, (path.name, sha256_of(path))))
    return own


def own_effects(own: Mapping[str, Effect]) -> list[dict[str, str]]:
    """A user's effects as provenance keeps them: name, file and its SHA-256; the last two only
    where a file was loaded (`load_file`)."""
    keys = ("file", "sha256")
    return [{"name": n, **dict(zip(keys, _FILES.get(n, ()), strict=False))} for n in own]


def named(name: str) -> Effect:
    """One effect of the catalogue; raises UsageError with the nearest names."""
    import difflib

    effects = catalogue()
    found = known(name)
    if found is None:
        close = ", ".join(difflib.get_close_matches(name, effects, 3)) or ", ".join(effects)
        raise UsageError(f"no effect is called '{name}'", remedy=f"did you mean: {close}")
    return found


def _add(found: dict[str, Effect], effects: tuple[Effect, ...], where: str) -> None:
    for effect in effects:
        if effect.name in found:
            raise UsageError(
                f"two effects are called '{effect.name}'",
                where=where,
                remedy="rename it: `imucal effects` lists the names that are taken",
            )
        found[effect.name] = effect
