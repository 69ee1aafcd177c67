"""What one test loads into the catalogue, the next must not see."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from imucalib import effects


@pytest.fixture(autouse=True)
def own_effects_are_forgotten() -> Iterator[None]:
    yield
    effects._LOADED.clear()
