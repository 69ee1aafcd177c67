"""The worn recordings of the closed loop's benchmark, written apart from the program."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from types import ModuleType

import pytest

from worlds.places import ROOT


@pytest.fixture(scope="module")
def worn() -> Iterator[ModuleType]:
    folder = str(ROOT / "benchmarks" / "closed_loop")
    sys.path.insert(0, folder)
    yield importlib.import_module("worn_walk")
    sys.path.remove(folder)
