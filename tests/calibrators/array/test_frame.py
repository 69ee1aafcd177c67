"""Gains of a board whose attitude no rest shows: turned to their mean, with the doubt of that."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from imucalib.calibrators.array.rests import framed_misalignment, in_the_mean_frame
from imucalib.core.effect import Context, Truth
from imucalib.core.model import Model
from imucalib.effects import named

IMUS = ("a", "b", "c")
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TURN = np.array([np.eye(3), QUARTER, QUARTER @ QUARTER])


def fitted(seed: int, size: float) -> SimpleNamespace:
    """A fit with sizes of a few percent, an offset and a drift, without any rest."""
    rng = np.random.default_rng(seed)
    base = (named("bias"), named("scale"), framed_misalignment(), named("bias_drift"))
    model = Model(base)
    n = 5
    context = Context(
        n, {"order": np.linspace(0.0, 1.0, n), "record": np.arange(float(n))}, IMUS, attitude=TURN
    )
    parameters = model.parameters(context)
    theta = size * np.array([p.typical for p in parameters]) * rng.normal(size=len(parameters))
    root = (
        rng.normal(size=(theta.size, theta.size))
        * np.array([p.typical for p in parameters])[:, None]
    )
    covariance = 1e-4 * root @ root.T
    return SimpleNamespace(
        model=model, theta=theta, covariance=covariance,
        observations=SimpleNamespace(context=context),
    )  # fmt: skip


def read(fit: SimpleNamespace, theta: np.ndarray, force: np.ndarray) -> np.ndarray:
    """(3,) force of a direction -> what each triad reads of it at the end: (K, 3)."""
    end = fit.observations.context.take(np.array([4]))
    truth = np.broadcast_to(force, (1, 3, 3))
    return fit.model.predict(theta, np.asarray(truth), end).reading[0]


def plain(fit: SimpleNamespace, theta: np.ndarray) -> np.ndarray:
    """(K, 3, 3) gains by differences of readings, all turned until their mean does not turn."""
    still = read(fit, theta, np.zeros(3))
    gain = np.stack([read(fit, theta, axis) - still for axis in np.eye(3)], axis=2)
    in_board = TURN @ gain @ TURN.transpose(0, 2, 1)
    for _ in range(20):
        # The rotation R of all gains, G R, for which the mean of G R is symmetric to first order.
        mean = in_board.mean(axis=0)
        u, _, v = np.linalg.svd(mean)
        whole = u @ v  # nearest rotation
        in_board = in_board @ whole.T
    return TURN.transpose(0, 2, 1) @ in_board @ TURN


def test_the_mean_of_the_gains_does_not_turn() -> None:
    fit = fitted(1, 1.0)
    gain, _ = in_the_mean_frame(fit, TURN)  # type: ignore[arg-type]
    mean = np.mean(TURN @ gain @ TURN.transpose(0, 2, 1), axis=0)
    assert np.abs(mean - mean.T).max() < 1e-9
    np.testing.assert_allclose(gain, plain(fit, fit.theta), atol=1e-4)


def test_the_first_triad_holds_the_frame() -> None:
    """x along its x and y in its x-y plane: three of its six misalignments are none."""
    effect = framed_misalignment()
    context = Context(1, {}, IMUS)
    names = [p.name for p in effect.parameters(context)]
    every = [p.name for p in named("accelerometer_misalignment").parameters(context)]  # type: ignore[union-attr]
    assert names == [*every[2:3], *every[4:]]
    assert {p.typical for p in effect.parameters(context)} == {2.0}
    theta = np.random.default_rng(0).normal(size=len(names))
    truth = Truth(np.random.default_rng(1).normal(size=(1, 3, 3)))
    action = effect.act(theta, truth, context)
    whole = named(
        "accelerometer_misalignment"
    ).act(  # type: ignore[union-attr]
        np.concatenate([[0.0, 0.0], theta[:1], [0.0], theta[1:]]), truth, context
    )
    np.testing.assert_allclose(action.delta, whole.delta)
    np.testing.assert_allclose(action.d_theta @ theta, whole.delta, atol=1e-12)
