"""What stands after a jump of the bench: the same readings, told in two ways."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.effects import named
from imucalib.effects.scans import trust_records
from imucalib.estimators.least_squares import fit
from imucalib.posterior.search.trust import split_at_jump
from worlds.bench import BASE, base_model, bench, draw, ordinary_theta

ROW = 23


def calibrated(*, level: bool, names: tuple[str, ...] = BASE) -> Fit:
    """A bench's fit: of a sensor without errors, or of an ordinary one."""
    blank, model = bench(3, exact=True), base_model(names)
    return fit(model, blank if level else draw(model, ordinary_theta(model, blank, 4), blank, 5))


def jump(kind: str) -> Effect:
    """Of "slip:z" the effect slip@record23:z."""
    family, *way = kind.split(":")
    return named(":".join((f"{family}@record{ROW}", *way)))


@pytest.mark.parametrize(("kind", "axes"), [("slip:z", "z"), ("slip", "xyz")])
def test_a_tool_that_stands_straight_turns_back_by_what_it_slipped(kind: str, axes: str) -> None:
    """Where the later part stands as it was set, all of the sheet is turned by the slip, and the
    earlier part back."""
    found = calibrated(level=True)
    parts = split_at_jump(found, found.model, jump(kind))
    assert parts is not None
    assert np.array_equal(parts.after, np.arange(found.observations.n) >= ROW - 1)
    names = [p.name for p in found.parameters]
    due = np.zeros((len(names), len(axes)))
    for k, axis in enumerate(axes):
        due[names.index(f"mounting_{axis}"), k] = -1.0
    assert parts.taken_over == pytest.approx(due, abs=1e-9)


@pytest.mark.parametrize("kind", ["slip:z", "slip", "inclination_step"])
def test_readings_are_the_same_whichever_part_stands(kind: str) -> None:
    """To first order: parameters b and a jump u before which the sheet stands read as b - M u and u
    after which it does, for a sensor with errors of its own."""
    names = (*BASE, "inclination_zero") if kind == "inclination_step" else BASE
    found, effect = calibrated(level=False, names=names), jump(kind)
    parts = split_at_jump(found, found.model, effect)
    assert parts is not None
    data, grown = found.observations, found.model.plus(effect)
    last = float(data.context["record"].max())
    slices = grown.slices(data.context)
    own = np.concatenate(
        [np.arange(grown.start(data.context).size)[slices[n]] for n in found.model.names]
    )
    truth = data.reference.truth(found.eta)

    def read(after: bool, u: np.ndarray, b: np.ndarray) -> np.ndarray:
        context = trust_records(data.context, last, last) if after else data.context
        theta = grown.start(data.context)
        theta[own], theta[slices[effect.name]] = b, u
        return grown.predict(theta, truth, context).force

    for u in 1e-5 * np.eye(parts.taken_over.shape[1]):
        away = read(True, u, found.theta - parts.taken_over @ u) - read(False, u, found.theta)
        moved = read(False, u, found.theta) - read(False, 0.0 * u, found.theta)
        assert np.linalg.norm(away) < 1e-5 * np.linalg.norm(moved)


def test_no_part_is_in_doubt_where_readings_or_the_user_decide() -> None:
    """No dial zero in the base takes a dial's jump over; a scale's jump is none of the bench; and
    what is trusted is not asked for."""
    found = calibrated(level=True)
    assert split_at_jump(found, found.model, jump("inclination_step")) is None
    assert split_at_jump(found, found.model, jump("scale_step")) is None
    assert split_at_jump(found, found.model, named("clamp_creep")) is None
    data = found.observations
    said = replace(found, observations=replace(data, context=trust_records(data.context, 0.0, 9.0)))
    assert split_at_jump(said, said.model, jump("slip")) is None
