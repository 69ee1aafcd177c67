"""What the rests' own search found stands before what the motion's found, under its own names."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from imucalib.calibrators.array.effect_blocks import rest_steps, with_rests
from imucalib.loop.found import Checked, Step, Unexplained


@dataclass(frozen=True)
class Found:
    steps: tuple[Step, ...]
    rejected: tuple[tuple[str, str], ...]
    unexplained: tuple[Unexplained, ...]
    rests: object = None
    records: tuple[str, ...] = ()


def test_names_sizes_and_order() -> None:
    step = Step("warm_up", 7.0, (Checked("left out", "mg", 2.0, 1.0),), ())
    curve = Unexplained("a curve", "time", "probe", 0.99, 6.0)
    fit = SimpleNamespace(
        theta=np.array([9.0, 3.0, 4.0, 0.0, 0.0]), observations=SimpleNamespace(context=None),
        parameters=[SimpleNamespace(unit=u) for u in ("1", "mg", "mg", "mg", "mg")],
        model=SimpleNamespace(slices=lambda _: {"warm_up": slice(1, 5)}),
    )  # fmt: skip
    rests = SimpleNamespace(
        steps=(step,), rejected=(("cubic", "chance"),), unexplained=(curve,), records=("row 3",),
        final=fit,
    )  # fmt: skip
    moving = Found((Step("gyro_delay", 9.0, (), ()),), (("gyro_bias", "none"),), (curve,))
    (told,) = rest_steps(rests)  # type: ignore[arg-type]
    assert told.effect == "at rest: warm_up"
    assert told.value == "2.5 mg rms of 4"
    assert [c.name for c in told.checked] == ["rests"]
    made = with_rests(moving, rests)  # type: ignore[type-var]
    assert [s.effect for s in made.steps] == ["at rest: warm_up", "gyro_delay"]
    assert made.rejected == (("at rest: cubic", "chance"), ("gyro_bias", "none"))
    assert [u.name for u in made.unexplained] == ["a curve", "at rest: a curve"]
    assert made.records == ("row 3",)
    assert with_rests(moving, None) is moving  # type: ignore[type-var]
