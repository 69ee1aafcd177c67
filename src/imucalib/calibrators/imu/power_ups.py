"""Several logs of one IMU: the bias of each power-up, and whether anything else differs.

Every log has a fit of its own, and leaves products of it: information and vector of accelerometer
and gains. What a power-up changes is a bias; a gain that has a part of its own in
each log says that they are no one calibration (another temperature, another chip, a blow).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.estimators.power_ups import Parts, parts_of, weigh_moved
from imucalib.estimators.turn_log import TurnLog, remove_bias
from imucalib.estimators.turns import (
    ACCELEROMETER,
    GAIN,
    LOWER,
    TurnFit,
    away_from_nominal,
    exposure,
    fit_turns,
    force_columns,
    rate_columns,
)
from imucalib.posterior.odds import FALSE_CLAIM
from imucalib.significant_digits import per_cent

_FIXED, _BIAS = ACCELEROMETER + GAIN, np.arange(3)
_OWN = np.array([i == j for i, j in LOWER])
_FACES = np.eye(3, dtype=bool).ravel()
#: What no power-up changes: columns, which move by this where they do (data sheets: 0.1 %).
_BLOCKS: dict[str, Index] = {
    "the accelerometer's scale": 3 + np.flatnonzero(_OWN),
    "the accelerometer's cross terms": 3 + np.flatnonzero(~_OWN),
    "the gyroscope's scale": ACCELEROMETER + np.flatnonzero(_FACES),
    "the gyroscope's cross terms": ACCELEROMETER + np.flatnonzero(~_FACES),
}
_MOVED = 1e-3


def products_of(fit: TurnFit) -> tuple[Array, Array]:
    """(L, 18, 18) and (L, 18): what each log alone says of accelerometer and gains beside nominal
    ones, what was known before taken off and other effects held."""
    known = np.diag(fit.variance[-fit.state.first_drift :][:_FIXED] ** -1.0)
    log, information, vector = _drop_laws(fit), [], []
    for k in range(log.sessions):
        own = fit_turns(log.of_session(k))
        whole = np.linalg.inv(own.covariance[:_FIXED, :_FIXED])
        information.append(whole - known)
        vector.append(whole @ away_from_nominal(own.state)[:_FIXED])
    return np.array(information), np.array(vector)


def _drop_laws(fit: TurnFit) -> TurnLog:
    """The log of a fit as it would read without the laws."""
    log, state, turns = fit.log, fit.state, []
    for turn in log.turns:
        seen, _ = remove_bias(log, state.drift, turn)
        force = state.force(turn.force, log.session[turn.rest])
        true, _ = exposure(state, seen, force, turn, fit.laws)
        turns.append(replace(turn, rate=turn.rate - (seen - true)))
    still = log.rate - rate_columns(log, state, fit.laws) @ state.theta
    force = log.force - force_columns(state, fit.laws) @ state.theta
    return replace(log, rate=still, force=force, turns=tuple(turns))


def describe_differing(
    information: Array, vector: Array, names: tuple[str, ...]
) -> tuple[str, ...]:
    """One sentence for each kind of parameter that differs from log to log. names : of the logs"""
    typical, said = np.full(_FIXED, _MOVED), []
    for what, probability in weigh_moved(information, vector, _BLOCKS, typical, _BIAS)[1].items():
        if probability < FALSE_CLAIM / (1.0 + FALSE_CLAIM):
            continue
        block = _BLOCKS[what]
        parts = parts_of(information, vector, block, _BIAS)
        away = parts.predict(10.0 * typical[block])[0]
        k, axis = np.unravel_index(np.argmax(np.abs(away)), away.shape)
        said.append(
            f"{what} differs between the recordings ({per_cent(probability)}): {names[k]} is "
            f"{100.0 * away[k, axis]:+.2g} % off the mean of all; they are no one calibration"
        )
    return tuple(said)


def bias_parts(information: Array, vector: Array, mg: float) -> Parts:
    """Of the accelerometer's bias in mg. mg : in one g of the place"""
    return parts_of(information, vector, _BIAS, np.arange(0)).in_unit(mg * np.eye(3))
