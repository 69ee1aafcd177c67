"""What is found by being there: a new effect, format or export is one new file in its folder."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from types import ModuleType


def modules_of(package: str) -> Iterator[ModuleType]:
    """Every module below a package, rooms inside it too, in the order of their names."""
    path = importlib.import_module(package).__path__
    for info in sorted(pkgutil.iter_modules(path), key=lambda m: m.name):
        name = f"{package}.{info.name}"
        if info.ispkg:
            yield from modules_of(name)
        else:
            yield importlib.import_module(name)
