"""What one test loads into the catalogue, the next must not see."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

# As the command does: threads that wait for each other cost ten times the work on small matrices.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from imucalib import effects


@pytest.fixture(autouse=True)
def own_effects_are_forgotten() -> Iterator[None]:
    yield
    effects._LOADED.clear()
