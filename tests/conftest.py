"""What holds for all tests: threads, and that none sees what another loaded."""

from __future__ import annotations

import inspect
import os
from collections.abc import Iterator
from functools import partialmethod

import pytest

# As the command does: threads that wait for each other cost ten times the work on small matrices.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from click.testing import CliRunner
from hypothesis import HealthCheck, settings

from imucalib import effects

# No test is timed: a busy machine is no defect.
settings.register_profile(
    "any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("any machine")

if "mix_stderr" in inspect.signature(CliRunner.__init__).parameters:  # click 8.1
    CliRunner.__init__ = partialmethod(CliRunner.__init__, mix_stderr=False)


@pytest.fixture(autouse=True)
def own_effects_are_forgotten() -> Iterator[None]:
    yield
    effects._LOADED.clear()
