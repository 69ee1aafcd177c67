"""The cases, a file a command or block of options, found by being here."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from options.case import Case


def cases() -> tuple[Case, ...]:
    """Every case of every file."""
    found = [import_module(f"{__name__}.{info.name}") for info in iter_modules(__path__)]
    return tuple(case for module in found for case in module.CASES)
