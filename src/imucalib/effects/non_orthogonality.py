"""Angles between the sensing axes: the lower triangle, so that x keeps its direction; and their
change with the temperature."""

from collections.abc import Callable, Sequence

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Basis, Context, Parameter, Response, Truth

#: (axis that reads, axis that leaks in): y sees x, z sees x, z sees y.
_PAIRS = ((1, 0), (2, 0), (2, 1))
#: The same and their mirror images: where directions are known, a turn of the triad shows too.
_ALL = (*_PAIRS, *((leaks, reads) for reads, leaks in _PAIRS))


def leaks(pairs: Sequence[tuple[int, int]]) -> tuple[Basis, Basis]:
    """Basis and its slopes of what axes (reads, leaks in) see of a force, 1 of 1."""

    def basis(truth: Truth, context: Context) -> Array:
        out = np.zeros((*truth.shape, len(pairs)))
        for column, (reads, leaks) in enumerate(pairs):
            out[..., reads, column] = truth.force[..., leaks]
        return out

    def basis_dx(truth: Truth, context: Context) -> Array:
        out = np.zeros((*truth.shape, len(pairs), 3))
        for column, (reads, leaks) in enumerate(pairs):
            out[..., reads, column, leaks] = 1.0
        return out

    return basis, basis_dx


def driven(
    pairs: Sequence[tuple[int, int]], drive: Callable[[Context], Array]
) -> tuple[Basis, Basis]:
    """The same, of a thousandth for each unit of a drive (n,)."""

    def times(basis: Basis) -> Basis:
        def of(truth: Truth, context: Context) -> Array:
            one = basis(truth, context)
            return np.asarray(one * 1e-3 * drive(context).reshape(-1, *[1] * (one.ndim - 1)))

        return of

    basis, basis_dx = leaks(pairs)
    return times(basis), times(basis_dx)


def _warmth(context: Context) -> Array:
    return context["temperature"] - 25.0


def _with_temperature(pairs: Sequence[tuple[int, int]], name: str) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(f"{name}_{'xyz'[r]}{'xyz'[s]}", "mg/g/degC", 0.2, 6.0, usual=0.8)
        for r, s in pairs
    )


_SOURCE = "package stress; taken as a scale's change, as no data sheet states it"
_IDENTIFY = "Record the temperature; repeat directions between the axes at two temperatures."
_COLUMNS, _SLOPES = leaks(_PAIRS)
_WARM, _WARM_SLOPES = driven(_PAIRS, _warmth)
_TURNED, _TURNED_SLOPES = driven(_ALL, _warmth)


EFFECTS = (
    Response(
        "non_orthogonality",
        "The three sensing axes are not at right angles: y sees some x, z sees some x and y.",
        "y_y = x_y + k_yx x_x;  y_z = x_z + k_zx x_x + k_zy x_y",
        "paper 002 eq. (1), K lower triangular; paper 004 eq. (4) by angles",
        "Hold the sensor in directions between its axes, in all octants.",
        each=tuple(Parameter(f"cross_{'xyz'[r]}{'xyz'[s]}", "1", 0.02, 0.3) for r, s in _PAIRS),
        basis=_COLUMNS,
        basis_dx=_SLOPES,
    ),
    Response(
        "temperature_non_orthogonality",
        "The angles between the sensing axes follow the temperature.",
        "y_y = x_y + c_yx x_x (T - 25 °C);  y_z = x_z + (c_zx x_x + c_zy x_y) (T - 25 °C)",
        _SOURCE,
        _IDENTIFY,
        ("temperature",),
        each=_with_temperature(_PAIRS, "temperature_cross"),
        basis=_WARM,
        basis_dx=_WARM_SLOPES,
    ),
    Response(
        "temperature_misalignment",
        "Each sensing axis tilts with the temperature, towards both others.",
        "y_i = x_i + (c_ij x_j + c_ik x_k) (T - 25 °C)",
        _SOURCE,
        _IDENTIFY,
        ("temperature",),
        # The norm of a reading does not show the turn in it.
        part_of="temperature_non_orthogonality",
        each=_with_temperature(_ALL, "temperature_tilt"),
        basis=_TURNED,
        basis_dx=_TURNED_SLOPES,
    ),
)
