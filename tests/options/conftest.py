"""One bench for all tests of options: a run that two of them need is made once."""

from __future__ import annotations

import pytest

from options.bench import Bench


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return Bench(tmp_path_factory.mktemp("options"))
