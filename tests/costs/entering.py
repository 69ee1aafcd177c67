"""A pytest plugin that writes which functions each test enters, its processes' included, and its
CPU seconds: one line of JSON a test, into the file that IMUCAL_REACH names.

What several tests share is entered by all that use it: fixtures of a wider scope by name, and
functions with a cache by all tests of the files that know them.
"""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest
from entered_functions import entered  # type: ignore[import-not-found]

_OF_FIXTURE = defaultdict[str, set[str]](set)
_FAILED: set[str] = set()


def _spent() -> float:
    """CPU s of this process and of those that it started."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.failed:
        _FAILED.add(report.nodeid)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(
    fixturedef: pytest.FixtureDef[object], request: pytest.FixtureRequest
) -> Iterator[object]:
    if fixturedef.scope == "function":
        return (yield)
    before = set(entered)
    entered.clear()
    result = yield
    _OF_FIXTURE[fixturedef.argname].update(entered)
    entered.update(before)
    return result


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[object]:
    by_processes = Path(os.environ["IMUCAL_ENTERED"])
    by_processes.write_text("")
    entered.clear()
    start = _spent()
    result = yield
    names = entered.union(by_processes.read_text().split())
    for fixture in getattr(item, "fixturenames", ()):
        names |= _OF_FIXTURE[fixture]
    row = {"test": item.nodeid, "passed": item.nodeid not in _FAILED,
           "seconds": round(_spent() - start, 3), "entered": sorted(names)}  # fmt: skip
    with Path(os.environ["IMUCAL_REACH"]).open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")
    return result
