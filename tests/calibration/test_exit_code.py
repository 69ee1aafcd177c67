"""What a run ends with: an open question that changes the numbers, or what a gate names."""

from __future__ import annotations

from dataclasses import replace

import pytest

from imucalib.calibration.findings import Findings
from imucalib.calibration.outcome import (
    ErrorSummary,
    Gate,
    HeldOutError,
    Outcome,
    open_question,
)
from imucalib.calibration.provenance import provenance_of
from imucalib.loop.found import Unexplained

ERROR = ErrorSummary("error, rms", "mg", 9.0, 3.0, 1.0, 0.5, HeldOutError(9.0, 3.0, 2.0))
NAMELESS = Unexplained("slow changes", "order", "probe", 0.99, 9.0)


def outcome(findings: Findings, size: float = 0.0) -> Outcome:
    made = provenance_of(path="t", sha256="", samples=3, mapping={}, settings={})
    left = (open_question(size, ERROR),) if size else ()
    return Outcome("lab", (ERROR,), made, findings, left=left)


@pytest.mark.parametrize(("size", "code"), [(1.9, 0), (2.1, 5)])
def test_an_open_question_counts_where_it_is_larger_than_what_the_result_is_good_to(
    size: float, code: int
) -> None:
    found = outcome(Findings("unexplained", unexplained=(NAMELESS,)), size)
    assert found.exit_code == code
    assert found.status == ("marginal" if code else "ok")
    assert ("more than" in found.left[0].sentence) == (code == 5)


@pytest.mark.parametrize(
    ("findings", "gates"),
    [
        (Findings("nothing missing"), set()),
        (Findings("explained"), set()),
        (Findings("suspected"), {"suspected", "unexplained", "caution"}),
        (Findings("unexplained", unexplained=(NAMELESS,)), {"unexplained", "caution"}),
    ],
)
def test_gates_are_stricter(findings: Findings, gates: set[Gate]) -> None:
    found = outcome(findings)
    assert found.exit_code == 0
    for gate in ("suspected", "unexplained", "caution"):
        strict = replace(found, fail_on=gate)  # type: ignore[arg-type]
        assert strict.exit_code == (5 if gate in gates else 0)


def test_what_the_headline_warns_of_may_be_gated() -> None:
    warned = replace(outcome(Findings("explained")), reasons=("few attitudes",))
    assert warned.exit_code == 0
    assert replace(warned, fail_on="suspected").exit_code == 0
    assert replace(warned, fail_on="caution").exit_code == 5
