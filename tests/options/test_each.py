"""Each option does what its case says, and nothing else."""

from __future__ import annotations

import pytest

from options.bench import Bench
from options.case import Case, held
from options.cases import cases


@pytest.mark.slow
@pytest.mark.parametrize("case", [pytest.param(c, id=c.label) for c in cases()])
def test_the_option_does_it(case: Case, bench: Bench) -> None:
    held(case, bench)
    assert bench.run(case.whole).code in (0, 1, 2, 3, 4, 5, 6), "no code of imucal"
