"""What is left of the position before: a share of its reading, or the side that it lay on."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Basis, Context, Response, Truth, three
from imucalib.units import MG, STANDARD_GRAVITY

_BEFORE = ("previous_x", "previous_y", "previous_z")
_IDENTIFY = "Approach some positions from both sides."
_SIDE = ("approach_x", "approach_y", "approach_z")
#: m/s², a smaller move of an axis has no side.
_MOVED = 0.02 * STANDARD_GRAVITY


def covariates_before(reading: Array) -> dict[str, Array]:
    """Of rests (n, 3) m/s² in order of time each axis' reading before (n,) m/s², and the side from
    which it came (n,), -1, 0 or 1; the first stands for what was before it."""
    before = np.concatenate([reading[:1], reading[:-1]])
    moved = reading - before
    side = np.sign(moved) * (np.abs(moved) > _MOVED)
    return dict(zip((*_BEFORE, *_SIDE), (*before.T, *side.T), strict=True))


def _each_axis(names: tuple[str, ...], unit: float) -> Basis:
    """Of each axis its own covariate, in this unit."""

    def basis(truth: Truth, context: Context) -> Array:
        own = np.stack([context[name] for name in names], axis=-1)[:, None, :, None]
        return np.broadcast_to(np.eye(3) * unit * own, (*truth.shape, 3))

    return basis


EFFECTS = (
    Response(
        "hysteresis",
        "The reading keeps a share of the previous position's.",
        "y_i = x_i + h_i x_i(previous position)",
        "about 1 mg/g, practice",
        _IDENTIFY,
        _BEFORE,
        each=three("hysteresis", "mg/g", 1.0, 30.0),
        basis=_each_axis(_BEFORE, 1e-3),
    ),
    Response(
        "approach_hysteresis",
        "The reading differs by the side from which an axis came to it.",
        "y_i = x_i + h_i sign(x_i - x_i(previous position))",
        "hysteresis between rising and falling input, IEEE Std 1293; about 1 mg, practice",
        _IDENTIFY,
        _SIDE,
        each=three("approach_hysteresis", "mg", 1.0, 30.0),
        basis=_each_axis(_SIDE, MG),
    ),
)
