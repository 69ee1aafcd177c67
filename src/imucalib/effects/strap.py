"""An offset that depends on the posture, as a strap that presses the case in some of them makes it.

The size of gravity shows of a bias b(u) at the posture u only its part along gravity, u·b(u). That
part is free here: a sum of bumps spread evenly over the sphere, each as wide as the way to its
neighbours, less what bias, scale and non-orthogonality do, the harmonics up to second degree. It
holds every response of the axes too, if coarsely: what a few numbers explain as well has their
name. Without a force there is no posture: the offset fades below a twentieth of g.
"""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Effect, Response, Truth
from imucalib.core.sphere import even_directions
from imucalib.effects.parts import scan, sizes, words
from imucalib.units import MG, STANDARD_GRAVITY

#: Bumps that are tried, and observations from which on: one for each of the finer, whose prior
#: holds them, and fewer than a converter's curve needs, which clusters of postures would pass for.
_BUMPS, _FEWEST = (24, 80), 80
_MOST = 400
_FADES = 0.05 * STANDARD_GRAVITY  # m/s²


def _up(truth: Truth) -> tuple[Array, Array]:
    """Direction (n, K, 3) of the force, shorter where little is felt, and its size (n, K, 1)."""
    size = np.sqrt(np.sum(truth.force**2, axis=-1, keepdims=True) + _FADES**2)
    return truth.force / size, size


def _harmonics(sharp: float) -> Array:
    """(3,) coefficients of 1, t and t² in exp(sharp (t - 1)), t the cosine to a bump's centre: its
    Legendre series up to second degree, over a sphere of postures."""
    t, weight = np.polynomial.legendre.leggauss(64)
    each = np.polynomial.legendre.legvander(t, 2)
    series = (np.arange(3) + 0.5) * ((weight * np.exp(sharp * (t - 1.0))) @ each)
    return np.asarray(np.polynomial.legendre.leg2poly(series))


def posture(value: str) -> Effect:
    """The offset as a sum of so many bumps, "24"; ValueError otherwise."""
    bumps = int(value)
    if not 0 < bumps <= _MOST:
        raise ValueError(f"'{value}' is no number of bumps")
    middle, sharp = even_directions(bumps), bumps / (4.0 * np.pi)  # one over the area of each
    lower = _harmonics(sharp)
    steep = np.polynomial.Polynomial(lower).deriv().coef

    def heights(truth: Truth) -> tuple[Array, Array, Array, Array]:
        up, size = _up(truth)
        near = up @ middle.T
        return up, size, near, np.exp(sharp * (near - 1.0))

    def total(theta: Array, truth: Truth, context: Context) -> Array:
        # A long recording asks for this; single precision is a part in ten million of the offset.
        up, _ = _up(truth)
        fall = up.astype(np.float32) @ (sharp * middle.T).astype(np.float32) - np.float32(sharp)
        square = np.sum((up @ (middle.T * theta @ middle)) * up, axis=-1)
        base = lower[0] * theta.sum() + lower[1] * (up @ (theta @ middle)) + lower[2] * square
        return np.asarray(MG * up * (np.exp(fall) @ theta.astype(np.float32) - base)[..., None])

    def basis(truth: Truth, context: Context) -> Array:
        up, _, near, height = heights(truth)
        height = height - np.polynomial.polynomial.polyval(near, lower)
        return np.asarray(MG * up[..., :, None] * height[..., None, :])

    def basis_dx(truth: Truth, context: Context) -> Array:
        up, size, near, height = heights(truth)
        flat = (np.eye(3) - up[..., :, None] * up[..., None, :]) / size[..., None]
        rest = height - np.polynomial.polynomial.polyval(near, lower)
        turned = flat[..., :, None, :] * rest[..., None, :, None]
        slope = sharp * height - np.polynomial.polynomial.polyval(near, steep)
        uphill = slope[..., None] * (middle @ flat)
        return np.asarray(MG * (turned + up[..., :, None, None] * uphill[..., None, :, :]))

    return Response(
        *words("posture@", value, bumps=value),
        each=sizes("posture@", (str(k + 1) for k in range(bumps)), value),
        basis=basis,
        basis_dx=basis_dx,
        total=total,
    )


def _values(context: Context) -> tuple[str, ...]:
    """Where no dial says which way is up: a bench knows more than the size of gravity."""
    if "time" not in context or "inclination" in context or len(context.triads) > 1:
        return ()
    return tuple(map(str, _BUMPS)) if context.n >= _FEWEST else ()


FAMILIES = (scan("posture", posture, _values, free=True),)
