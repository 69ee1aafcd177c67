"""The record of what tests enter, and the tiers that follow from it."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import pytest

from costs import tiers
from costs.reach import Reach, enclosing, noting

SOURCE = '''"""Words."""
from __future__ import annotations

HALF = 0.5


def outer(x: float) -> float:
    """What it does."""

    def inner(y: float) -> float:
        return HALF * y

    return inner(x) + (lambda z: z)(x)


class Thing:
    @property
    def size(self) -> float:
        return 2.0


FORMS = (lambda u: u,)
'''


@pytest.fixture
def noted(monkeypatch: pytest.MonkeyPatch) -> tuple[ModuleType, set[str]]:
    notes, entered = ModuleType("entered_functions"), set[str]()
    notes.entered = entered  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "entered_functions", notes)
    module = ModuleType("noted")
    exec(compile(noting(SOURCE, "m.py"), "m.py", "exec"), module.__dict__)
    return module, entered


def test_what_is_entered_is_noted_and_nothing_else_changes(
    noted: tuple[ModuleType, set[str]],
) -> None:
    module, entered = noted
    assert not entered
    assert module.outer(3.0) == 4.5
    assert entered == {"m.py:outer"}
    assert module.Thing().size + module.FORMS[0](1.0) == 3.0
    assert entered == {"m.py:outer", "m.py:Thing.size", "m.py:lambda"}
    assert (module.__doc__, module.outer.__doc__) == ("Words.", "What it does.")


@pytest.mark.parametrize(
    ("line", "name"), [(4, ""), (7, ""), (11, "outer"), (13, "outer"), (19, "Thing.size"), (22, "")]
)
def test_a_line_belongs_to_the_outermost_function(line: int, name: str) -> None:
    assert enclosing(SOURCE, line) == name


def test_tests_of_a_line_come_cheapest_first() -> None:
    reach = Reach(
        {
            "m.py:outer": frozenset({"tests/b", "tests/a"}),
            "m.py:Thing.size": frozenset({"tests/c"}),
        },
        {"tests/a": 0.2, "tests/b": 0.1, "tests/c": 0.0, "tests/room/d": 9.0, "tests/e": 0.0},
    )
    at = Path("m.py")
    assert reach.of(at, SOURCE, 11, ["tests/room"]) == ["tests/b", "tests/a"]
    outside = reach.of(at, SOURCE, 4, ["tests/room"])
    assert outside == ["tests/c", "tests/b", "tests/a", "tests/room/d"]
    assert set(reach.known_to(frozenset({"tests/a"})).seconds) == {"tests/a"}


def test_the_fast_tier_enters_what_a_bearable_test_enters() -> None:
    """ "both" enters what "one" and "two" do and costs less than they together; "alone" is too slow
    for what only it enters, and "quick" is quick."""
    seconds = {"quick": 0.1, "one": 0.9, "two": 0.9, "both": 1.0, "same": 0.6, "alone": 60.0}
    reach = Reach(
        {
            "f": frozenset({"tests/one", "tests/both"}),
            "g": frozenset({"tests/two", "tests/both"}),
            "h": frozenset({"tests/quick", "tests/same"}),
            "k": frozenset({"tests/alone"}),
        },
        {f"tests/{name}": cost for name, cost in seconds.items()},
    )
    assert tiers.chosen(reach) == ["alone", "one", "same", "two"]
