"""The posture runs of the closed loop's tests, written apart from the program."""

from __future__ import annotations

from types import ModuleType

import pytest

from worlds import worn_walk


@pytest.fixture(scope="module")
def worn() -> ModuleType:
    return worn_walk
