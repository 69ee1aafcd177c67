"""The balance of readings against prediction, with the free directions η taken out.

Linearised at (θ, η): r = reading - prediction + N η = J δθ + N η + noise. Flat directions are
projected out of each observation. Directions with a variance component c stay as correlated noise:

    V = s² diag(σ²) + Σ_c sd_c² N_c N_cᵀ

Noise that observations share stands beside them as components of its own, in m/s². Without it V
is the errors-in-variables likelihood of settings that rows share (generalised least squares
with variance components; Patterson and Thompson 1971 for the restricted likelihood).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.core.eigen import blocks_of
from imucalib.core.model import Model
from imucalib.core.observations import NoisePrior, Observations, SharedNoise

if TYPE_CHECKING:
    from scipy.sparse import csr_array

#: Below so many numbers one dense matrix is faster than its blocks; blocks that are inverted.
_FEW, _SMALL = 240, 12


@dataclass(frozen=True)
class Noise:
    """Noise of the readings and of the settings.

    factor : the readings' noise is factor * Observations.sigma
    component : names of the variance components, sd : their standard deviations (rad; of shared
        noise m/s²)
    """

    factor: float
    component: tuple[str, ...] = ()
    sd: tuple[float, ...] = ()

    @property
    def ratio(self) -> tuple[float, ...]:
        """Each component's sd over the readings' factor."""
        return tuple(sd / self.factor for sd in self.sd)


@dataclass(frozen=True)
class Balanced:
    """A linearised balance after projecting the flat directions.

    residual : (N,), jacobian : (N, p), both in units of Observations.sigma
    settings : per component, the matrix N_c (N, q_c) in those units per rad (of shared noise, which
        stands last, per m/s²); free : how many of them are free directions η
    keep : (n, m, m - flat) projection that was applied to each observation's 3K numbers
    prior : of the noise, or None
    owner : (N,) observation of each number
    """

    residual: Array
    jacobian: Array
    settings: tuple[Array, ...]
    component: tuple[str, ...]
    keep: Array
    owner: NDArray[np.intp]
    sigma: Array
    free: int = 0
    prior: NoisePrior | None = None

    @property
    def unit(self) -> Array:
        """(N,) m/s², the declared noise of each number."""
        whole = self.keep.shape[2] == self.sigma.shape[1]
        return self.sigma.reshape(-1) if whole else self.sigma[self.owner, 0]

    def columns(self, block: Array) -> Array:
        """Bring columns (n, K, 3, m) of a candidate effect, m/s² per unit, to the balance."""
        n, k, _, m = block.shape
        if self.keep.shape[2] == 1:  # without a scaled copy of what may be a large block
            weight = self.keep[..., 0] / self.sigma
            return np.asarray(np.einsum("nij,ni->nj", block.reshape(n, 3 * k, m), weight))
        scaled = block.reshape(n, 3 * k, m) / self.sigma[..., None]
        return np.asarray((self.keep.transpose(0, 2, 1) @ scaled).reshape(-1, m))


def balance(model: Model, theta: Array, eta: Array, observations: Observations) -> Balanced:
    """Linearise the model at θ and η. See the module's text for the meaning."""
    prediction = model.predict(theta, observations.reference.truth(eta), observations.context)
    directions = observations.reference.directions(eta)
    n, k, _ = prediction.reading.shape
    m, q = 3 * k, directions.index.shape[1]
    sigma = observations.sigma.reshape(n, m)
    residual = (observations.reading - prediction.reading).reshape(n, m) / sigma
    jacobian = prediction.d_theta.reshape(n, m, prediction.d_theta.shape[3]) / sigma[..., None]
    free = (prediction.d_truth @ directions.derivative).reshape(n, m, q)
    free = free / sigma[..., None]

    flat = [j for j, name in enumerate(directions.component) if name is None]
    keep = np.broadcast_to(np.eye(m), (n, m, m))
    if m == 3 and len(flat) == 2:
        # The one direction that is left, without a decomposition of every observation.
        across = np.cross(free[..., flat[0]], free[..., flat[1]])
        keep = (across / np.linalg.norm(across, axis=1, keepdims=True))[..., None]
    elif flat:
        keep = np.linalg.qr(free[..., flat], mode="complete")[0][..., len(flat) :]
    if flat:
        project = keep.transpose(0, 2, 1)
        residual = (project @ residual[..., None])[..., 0]
        jacobian, free = project @ jacobian, project @ free

    names = tuple(dict.fromkeys(c for c in directions.component if c is not None))
    settings, rows = [], keep.shape[2]
    for name in names:
        local = [j for j, c in enumerate(directions.component) if c == name]
        used, column = np.unique(directions.index[:, local], return_inverse=True)
        matrix = np.zeros((n, rows, used.size))
        for j, own in zip(local, column.reshape(n, -1).T, strict=True):
            matrix[np.arange(n), :, own] += free[..., j]
        settings.append(matrix.reshape(n * rows, -1))
        residual = residual + matrix @ eta[used]
    plain = Balanced(
        residual=residual.ravel(),
        jacobian=jacobian.reshape(n * rows, -1),
        settings=tuple(settings),
        component=names,
        keep=keep,
        owner=np.repeat(np.arange(n), rows),
        sigma=sigma,
        free=len(names),
        prior=observations.noise_prior,
    )
    shared = tuple(_stack_shared(plain, noise) for noise in observations.shared)
    component = (*names, *(noise.name for noise in observations.shared))
    return replace(plain, settings=(*plain.settings, *shared), component=component)


def _stack_shared(at: Balanced, noise: SharedNoise) -> Array:
    n = len(noise.factor)
    triads = at.sigma.shape[1] // 3
    basis = np.broadcast_to(np.eye(3), (n, 3, 3)) if noise.basis is None else noise.basis
    block = np.einsum("nq,nij->niqj", noise.factor, basis).reshape(n, 1, 3, -1)
    return at.columns(np.broadcast_to(block, (n, triads, 3, block.shape[3])))


@dataclass(frozen=True)
class Whitener:
    """Turns the balance into unit, independent noise: L⁻¹ with L Lᵀ = V / s².

    blocks : the rows (b, m) of all blocks of one size, and their L (b, m, m), of small ones L⁻¹;
        none where V / s² = 1
    """

    blocks: tuple[tuple[Index, Array], ...]
    log_det: float

    @property
    def plain(self) -> bool:
        """Whether V / s² = 1."""
        return not self.blocks

    def __call__(self, columns: Array) -> Array:
        return self._solve(columns, transposed=False)

    def weigh(self, columns: Array) -> Array:
        """V⁻¹ s² times columns."""
        return self.back(self(columns))

    def back(self, white: Array) -> Array:
        """L⁻ᵀ times columns."""
        return self._solve(white, transposed=True)

    def _solve(self, columns: Array, *, transposed: bool) -> Array:
        if not self.blocks:
            return columns
        solved = np.empty(columns.shape)
        for rows, lower in self.blocks:
            if lower.shape[1] <= _SMALL:
                own = columns[rows].reshape(*rows.shape, -1)
                turn = lower.transpose(0, 2, 1) if transposed else lower
                solved[rows] = (turn @ own).reshape(*rows.shape, *columns.shape[1:])
            elif rows.shape == (1, len(columns)):  # without a copy
                return below(lower[0], columns, transposed=transposed)
            else:
                for some, one in zip(rows, lower, strict=True):
                    solved[some] = below(one, columns[some], transposed=transposed)
        return solved


def below(lower: NDArray[np.floating[Any]], columns: Array, *, transposed: bool = False) -> Array:
    """L⁻¹, or L⁻ᵀ, times columns (n, m) or (n,), of a lower triangle L (n, n)."""
    from scipy.linalg.lapack import dtrtrs

    if not lower.size:
        return np.zeros(columns.shape)
    # The rows of a lower triangle in C's order are an upper one in Fortran's: no copy.
    return np.asarray(dtrtrs(lower.T, columns, lower=0, trans=0 if transposed else 1)[0])


@dataclass(frozen=True)
class SettingBlocks:
    """Readings that share no setting, through others neither, are independent: V comes apart into
    blocks, which are the same whatever the settings' sizes.

    rows : (b, m) of all blocks of one size; products : of each N_c the numbers of N_c N_cᵀ that are
    not zero, by where they stand in all blocks, one behind the other
    """

    rows: tuple[Index, ...]
    products: tuple[tuple[Index, Array], ...]

    @staticmethod
    def of(settings: Sequence[Array | csr_array]) -> SettingBlocks:
        """settings : N_c matrices, one or more"""
        from scipy.sparse import coo_array, csr_array, hstack

        n = settings[0].shape[0]
        every = [np.arange(n)]
        if n >= _FEW:
            settings = [csr_array(m) for m in settings]
            every = blocks_of(hstack(settings, format="csr"))
        sizes = sorted({rows.size for rows in every})
        rows = [np.array([one for one in every if one.size == size]) for size in sizes]
        (first, place), end = np.zeros((2, n), np.intp), 0
        for one in rows:
            count, size = one.shape
            first[one] = end + size * np.arange(one.size).reshape(one.shape)
            place[one] = np.arange(size)
            end += count * size**2
        found = []
        for matrix in settings:
            product = coo_array(matrix @ matrix.T)
            found.append((first[product.row] + place[product.col], product.data))
        return SettingBlocks(tuple(rows), tuple(found))

    def whitener(self, ratio: Sequence[float], scale: Array | None = None) -> Whitener:
        """ratio : sd_c / s (rad) of each N_c; scale : (N,) that each reading is divided by"""
        blocks, log_det, end = list[tuple[Index, Array]](), 0.0, 0
        numbers = np.zeros(sum(rows.size * rows.shape[1] for rows in self.rows))
        with np.errstate(over="ignore"):  # of a ratio that nothing bounds
            for rho, (at, product) in zip(ratio, self.products, strict=True):
                numbers[at] += rho * rho * product
        for rows in self.rows:
            size = rows.shape[1]
            whole = numbers[end : end + rows.size * size].reshape(-1, size, size)
            end += rows.size * size
            if scale is not None:
                whole /= scale[rows][:, :, None] * scale[rows][:, None]
            whole[:, np.arange(size), np.arange(size)] += 1.0
            lower = np.linalg.cholesky(whole)
            log_det += 2.0 * float(np.log(np.diagonal(lower, axis1=1, axis2=2)).sum())
            own = np.linalg.inv(lower) if size <= _SMALL else lower
            blocks.append((rows, np.asarray(own, np.float64)))
        return Whitener(tuple(blocks), log_det)


def whitener(settings: Sequence[Array | csr_array], ratio: Sequence[float]) -> Whitener:
    """For N_c matrices and ratios sd_c / s (rad)."""
    some = [(matrix, rho) for matrix, rho in zip(settings, ratio, strict=True) if rho]
    if not some:
        return Whitener((), 0.0)
    return SettingBlocks.of([m for m, _ in some]).whitener([rho for _, rho in some])


def setting_errors(at: Balanced, white: Whitener, ratio: tuple[float, ...], misfit: Array) -> Array:
    """Best linear unbiased prediction of η (rad) from the misfit r - J δθ, component by component.

    white : of the balance at these ratios. Concatenated in the components' order (Henderson 1975).
    """
    weighted = white.weigh(misfit)
    own = zip(at.settings[: at.free], ratio, strict=False)
    parts = [rho**2 * m.T @ weighted for m, rho in own]
    return np.concatenate(parts) if parts else np.zeros(0)
