"""The array posterior of `imucalib.estimators.array.likelihood` in JAX, for other samplers.

The same closed form and the same Laplace integral over each sample's rate, written apart from the
program and differentiated by JAX; `array_peers.py` checks both against each other.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)
_LEVI = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _LEVI[_i, _j, _k], _LEVI[_i, _k, _j] = 1.0, -1.0


def density(kept: Any) -> Callable[[Any], Any]:
    """log posterior of u (size,), the unknowns in prior standard deviations about the prior mean.

    kept : acceleration (T, A, 3), sigma (A,), rate (T, 3), precision (3, 3), nominal mean (size,),
    prior sd (size,), motion_scale
    """
    y, lam = jnp.asarray(kept["acceleration"]), jnp.asarray(kept["sigma"]) ** -2.0
    mean, sd = jnp.asarray(kept["mean"]), jnp.asarray(kept["sd"])
    rate, precision = jnp.asarray(kept["rate"]), jnp.asarray(kept["precision"])
    t, a = y.shape[:2]
    y = y - jnp.einsum("tai,a->ti", y, lam)[:, None] / lam.sum()
    power = jnp.einsum("tai,tai,a->t", y, y, lam)
    scale, eye, levi = float(kept["motion_scale"]), jnp.eye(3), jnp.asarray(_LEVI)

    def logp(u: Any) -> Any:
        x = mean + sd * u
        r = jnp.concatenate([jnp.zeros((1, 3)), x[: 3 * a - 3].reshape(-1, 3)])
        h = x[3 * a - 3 :]
        factor = jnp.diag(jnp.exp(h[:3])).at[jnp.array([1, 2, 2]), jnp.array([0, 0, 1])].set(h[3:])
        factor = factor / jnp.sqrt(scale)
        r = r - lam @ r / lam.sum()
        spread = jnp.einsum("ai,aj,a->ij", r, r, lam)
        inertia = jnp.trace(spread) * eye - spread
        stiff = inertia + factor @ factor.T
        gain = jnp.linalg.inv(stiff)
        moment = jnp.einsum("tai,aj,a->tij", y, r, lam)
        torque = jnp.einsum("ijk,tkj->ti", levi, moment)
        trace = jnp.trace(moment, axis1=1, axis2=2)

        def one(w: Any, n: Any, big: Any, tr: Any, yy: Any, g: Any) -> Any:
            jw = inertia @ w
            v = n - jnp.cross(w, jw)
            off = w - g
            return (0.5 * yy - w @ big @ w + w @ w * tr + 0.5 * (w @ w) * (w @ jw)
                    - 0.5 * v @ gain @ v + 0.5 * off @ precision @ off)  # fmt: skip

        bent = 2.0 * trace[:, None, None] * eye - moment - moment.transpose(0, 2, 1)
        values = jax.vmap(one)

        def slopes(w: Any) -> tuple[Any, Any]:
            jw = w @ inertia
            v = torque - jnp.cross(w, jw)
            spin = v @ gain
            ww, wjw = jnp.sum(w * w, 1), jnp.sum(w * jw, 1)
            turn = jnp.einsum("ikj,tk->tij", levi, jw)
            cross_w = jnp.einsum("ikj,tk->tij", levi, w)
            d = turn - cross_w @ inertia
            gradient = jnp.einsum("tij,tj->ti", bent, w) + w * wjw[:, None] + jw * ww[:, None]
            gradient += (w - rate) @ precision - jnp.einsum("tji,tj->ti", d, spin)
            outer = 2.0 * w[:, :, None] * jw[:, None]
            spun = jnp.einsum("ikj,tk->tij", levi, spin) @ inertia
            hessian = (bent + precision + ww[:, None, None] * inertia + wjw[:, None, None] * eye
                       + outer + outer.transpose(0, 2, 1) - spun - spun.transpose(0, 2, 1)
                       - jnp.einsum("tki,kl,tlj->tij", d, gain, d))  # fmt: skip
            return gradient, hessian

        w = rate
        for _ in range(3):
            w = w - solved(*slopes(w)[::-1])[0]
        # One more step from a constant: its derivative is that of the mode.
        w = jax.lax.stop_gradient(w)
        w = w - solved(*slopes(w)[::-1])[0]
        hessian = slopes(w)[1]
        f = values(w, torque, moment, trace, power, rate)
        total = -jnp.sum(f + 0.5 * jnp.log(solved(hessian, w)[1]))
        total -= 0.5 * t * jnp.linalg.slogdet(stiff)[1]
        return total + t * jnp.sum(h[:3]) - 0.5 * u @ u

    return logp


def solved(m: Any, v: Any) -> tuple[Any, Any]:
    """m^-1 v and det m of symmetric matrices (T, 3, 3), by cofactors."""
    xx, yy, zz, xy, xz, yz = (m[:, i, j] for i, j in
                              ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))  # fmt: skip
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * xz, xy * xz - yz * xx, xx * yy - xy * xy
    det = xx * a + xy * b + xz * c
    x, y, z = v[:, 0], v[:, 1], v[:, 2]
    out = jnp.stack([a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z], 1)
    return out / det[:, None], det
