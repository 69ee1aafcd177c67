"""What searches of one motion owe to earlier ones: where a fit begins, and what chance reaches.

The halves of a motion are searched again, each by itself. Their fits begin at the answer that the
whole has for the same effects, and end at their own: a start changes what a fit costs. What chance
reaches depends on the candidates and on the noise, and is drawn once for searches that have both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.setup import Setup, motion_at
from imucalib.calibrators.array.loop.state import ArrayState, moved_motion, settled
from imucalib.calibrators.array.loop.terms import Term
from imucalib.estimators.array.noise import SensorNoise
from imucalib.estimators.array.samples import Weights, fit_samples

#: Relative difference of the noise up to which what chance reaches is the same.
_ALIKE = 0.25


class Earlier:
    """Fits by the names of what is in them, and chance by the size of the noise.

    ended : effects with which the search of the whole has ended, without those that have rivals
    """

    def __init__(self) -> None:
        self.ended: tuple[str, ...] = ()
        self._fits: dict[frozenset[str], ArrayState] = {}
        self._chance: list[tuple[Array, Array]] = []

    def kept(self, state: ArrayState) -> ArrayState:
        """The same state, remembered as where fits of the same terms may begin."""
        # Without its columns, which are large.
        self._fits.setdefault(_names(state.terms), replace(state))
        return state

    def begun(self, state: ArrayState) -> ArrayState:
        """Samples, terms and motion of a state at the values of an earlier fit with the same terms;
        the state itself where there is none."""
        found = self._fits.get(_names(state.terms))
        if found is None:
            return state
        by = {term.name: term for term in found.terms}
        terms = tuple(_at(term, by[term.name]) for term in state.terms)
        # The shape of the noise is its own, as soon as a fit has asked for it.
        own = state.noise if state.converged else found.noise
        one, two = (replace(n, sigma=f.sigma) for n, f in zip(own, found.noise, strict=True))
        return moved_motion(replace(state, r=found.r, noise=(one, two), terms=terms))

    def chance(self, state: ArrayState, drawn: Callable[[], Array]) -> Array:
        """(draws,) what `drawn` gives at a state, or has given at one of the same noise."""
        size = np.array([np.mean(noise.sigma * noise.factor) for noise in state.noise])
        for other, best in self._chance:
            if np.all(np.abs(other / size - 1.0) < _ALIKE):
                return best
        best = drawn()
        self._chance.append((size, best))
        return best


def start_state(setup: Setup, terms: tuple[Term, ...]) -> ArrayState:
    """Fitted with the drawing and plain noise as the start."""
    return settled(drawn_state(setup, terms))


def drawn_state(setup: Setup, terms: tuple[Term, ...]) -> ArrayState:
    """The drawing with plain noise, and the motion under it: nothing is fitted yet."""
    k = setup.triads
    one = np.ones(k)
    noise = SensorNoise(0.2, 0.0, np.inf, one), SensorNoise(5e-3, 0.0, np.inf, one)
    rate = np.median(setup.readings.rate, axis=1)
    ones = np.ones(setup.readings.rate.shape[:2])
    weights = Weights(ones / noise[0].sigma ** 2, ones / noise[1].sigma ** 2)
    sampled = fit_samples(setup.readings, weights, setup.board.drawn, rate)
    return ArrayState(
        setup=setup,
        r=setup.board.drawn,
        terms=terms,
        noise=noise,
        sampled=sampled,
        motion=motion_at(setup, sampled, None),
        covariance=np.empty((0, 0)),
        density=-np.inf,
        converged=False,
    )


def _names(terms: Iterable[Term]) -> frozenset[str]:
    return frozenset(term.name for term in terms)


def _at(term: Term, by: Term) -> Term:
    """A term at the value of another of the same effect, as far as its own directions allow."""
    if not by.value.size or not term.value.size:
        return term
    value = np.asarray(np.linalg.lstsq(term.live, by.theta, rcond=None)[0], np.float64)
    sd = np.full_like(term.sd, by.sd[0]) if term.found else term.sd
    return replace(term, value=value, sd=sd)
