"""A pytest plugin that writes each test's CPU seconds, its processes included, into a file.

pytest -p costs.measuring          (IMUCAL_COSTS names the file)
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest


def spent() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    start = spent()
    result = yield
    with Path(os.environ["IMUCAL_COSTS"]).open("a", encoding="utf-8") as file:
        file.write(f"{spent() - start:.3f}\t{item.nodeid.removeprefix('tests/')}\n")
    return result
