"""What of a sensor or its bench changes, and what that follows: effects are made of the two.

A sensor's part is columns of pairs (axis that reads, axis whose force it reads): bias, scale
factors, angles between axes. A bench's part is axes of rotation: a dial, the seat of a tool. What
it follows is a covariate of the context, with one column or several. The parameters multiply both.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import (
    Basis,
    Context,
    Effect,
    Parameter,
    Response,
    Rotation,
    Stage,
    Truth,
    Turn,
)
from imucalib.units import MG

#: context -> (n,), or (n, m) where it has m columns.
Values = Callable[[Context], Array]
#: context -> (n, 3) unit vectors.
Axis = Callable[[Context], Array]
#: What one parameter does: (axis that reads, axis whose force it reads, None for a constant).
Column = tuple[tuple[int, int | None], ...]


@dataclass(frozen=True)
class Part:
    """unit : of the parameters, before that of the covariate
    columns : of a sensor's part; axes : of a bench's, turned about one after the other
    noun : subject of the effects' sentences; equation : around the covariate's term
    needs : covariates without which there is no such part; shared : by all triads
    """

    unit: str
    columns: tuple[Column, ...] = ()
    axes: tuple[Axis, ...] = ()
    noun: str = ""
    equation: str = ""
    needs: tuple[str, ...] = ()
    stage: Stage = "sensor"
    shared: bool = False

    @property
    def labels(self) -> tuple[str, ...]:
        """Of the parameters, one a column or axis: "x", "yx", or nothing where there is one."""
        if len(self.columns or self.axes) == 1:
            return ("",)
        if self.axes:
            return ("x", "y", "z")
        pairs = (column[0] for column in self.columns)
        return tuple("xyz"[i] + ("" if j in (i, None) else "xyz"[j]) for i, j in pairs)


@dataclass(frozen=True)
class Covariate:
    """needs : of the context; verb : with a part's noun a sentence; term : in a part's equation,
    tail : behind it; identify : how to record it; per : unit that follows the part's
    labels : of the columns of its values, one empty one where there is one column
    """

    needs: tuple[str, ...]
    verb: str
    term: str
    values: Values
    identify: str
    tail: str = ""
    per: str = ""
    labels: tuple[str, ...] = ("",)


def made(
    name: str,
    part: Part,
    covariate: Covariate,
    source: str,
    typical: float,
    plausible: float = 0.0,
    *,
    usual: float = inf,
    unit: str = "",
    sentence: str = "",
    equation: str = "",
    identify: str = "",
    prefix: str = "",
    part_of: str = "",
    remedy: str = "",
) -> Effect:
    """The effect: a part that follows a covariate.

    typical, plausible, usual : sizes of the parameters, `plausible` thirty times typical by default
    unit, sentence, equation, identify, prefix : where they differ from what part and covariate say;
        prefix is that of the parameters' names
    part_of, remedy : as `Described` has them
    """
    unit, prefix = unit or part.unit + covariate.per, prefix or re.sub("[@:]", "_", name)
    parameters = tuple(
        Parameter(
            "_".join(filter(None, (prefix, term, label))),
            unit, typical, plausible or 30.0 * typical, usual=usual,
        )
        for term in covariate.labels
        for label in part.labels
    )  # fmt: skip
    words = (
        name,
        sentence or f"The {part.noun} {covariate.verb}.",
        equation or part.equation.format(covariate.term) + covariate.tail,
        source,
        identify or covariate.identify,
        tuple(dict.fromkeys((*covariate.needs, *part.needs))),
    )
    if part.axes:
        turns = turned(part.axes, covariate.values)
        return Rotation(*words, named=parameters, turns=turns, stage=part.stage)
    basis, basis_dx = linear(part.columns, covariate.values, unit)
    return Response(
        *words,
        each=parameters,
        basis=basis,
        basis_dx=basis_dx,
        stage=part.stage,
        shared=part.shared,
        part_of=part_of,
        remedy=remedy,
    )


def linear(
    columns: tuple[Column, ...], values: Values, unit: str, *, inside: bool = False
) -> tuple[Basis, Basis | None]:
    """Basis of columns times the m columns of values, and its slope by the force, None of
    constants.

    unit : mg, mg/g or 1, whatever they are per
    inside : whether the columns of values run within one another's, else all first ones come first
    """
    size = 1e-3 if unit.startswith("mg/g") else MG if unit.startswith("mg") else 1.0
    forces = any(of is not None for column in columns for _, of in column)
    order = (0, 1, 2, 3, 4) if inside else (0, 1, 2, 4, 3)

    def of_context(context: Context) -> Array:
        """(n, 1, m)."""
        found = size * values(context)
        return (found if found.ndim == 2 else found[:, None])[:, None]

    def basis(truth: Truth, context: Context) -> Array:
        drive = of_context(context)
        n, triads, _ = truth.shape
        out = np.zeros((n, triads if forces else 1, 3, len(columns), drive.shape[2]))
        for k, column in enumerate(columns):
            for reads, of in column:
                out[:, :, reads, k] = drive if of is None else truth.force[..., of, None] * drive
        whole = out.transpose(order).reshape(*out.shape[:3], -1)
        return np.broadcast_to(whole, (n, triads, *whole.shape[2:]))

    def basis_dx(truth: Truth, context: Context) -> Array:
        drive = of_context(context)
        out = np.zeros((*truth.shape, len(columns), drive.shape[2], 3))
        for k, column in enumerate(columns):
            for reads, of in column:
                if of is not None:
                    out[:, :, reads, k, :, of] = drive
        return out.transpose(*order, 5).reshape(*truth.shape, -1, 3)

    return basis, basis_dx if forces else None


def turned(axes: tuple[Axis, ...], values: Values) -> tuple[Turn, ...]:
    """Turns about axes in their order, each by its own parameters times the columns of values."""

    def turn(k: int) -> Turn:
        def of(context: Context) -> tuple[Array, Array]:
            found = values(context).reshape(context.n, -1)
            weights = np.zeros((context.n, len(axes), found.shape[1]))
            weights[:, k] = found
            return axes[k](context), weights.reshape(context.n, -1)

        return of

    return tuple(turn(k) for k in range(len(axes)))


def always(context: Context) -> Array:
    return np.ones(context.n)


def waves(angle: Array) -> Array:
    """(n, 2) cosine and sine."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _of_tool(axis: int) -> Axis:
    return lambda context: np.broadcast_to(np.eye(3)[axis], (context.n, 3))


def inclination_axis(context: Context) -> Array:
    """About which a positive turn raises the inclination that the dial shows: (cos t, -sin t, 0) in
    the tool's frame at tool-face t, whatever the inclination, so that turns about it add."""
    t = context["tool_face"]
    axis = np.stack([np.cos(t), -np.sin(t), np.zeros_like(t)], axis=-1)
    return np.asarray(context.sense("inclination")[:, None] * axis)


def tool_face_axis(context: Context) -> Array:
    """About which a positive turn raises the tool-face that the dial shows: -z, where it runs from
    +y towards +x."""
    return np.asarray(context.sense("tool_face")[:, None] * np.array([0.0, 0.0, -1.0]))


_OWN: tuple[Column, ...] = (((0, 0),), ((1, 1),), ((2, 2),))
#: y sees x, z sees x, z sees y: x keeps its direction.
_BELOW: tuple[Column, ...] = (((1, 0),), ((2, 0),), ((2, 1),))
_ABOVE: tuple[Column, ...] = (((0, 1),), ((0, 2),), ((1, 2),))
_SCALED = "y_i = x_i (1 + {})"

BIAS = Part(
    "mg", (((0, None),), ((1, None),), ((2, None),)), noun="bias", equation="y_i = x_i + {}"
)
#: The same of the room and not of the sensor: no recording has its phase.
ROOM_BIAS = replace(BIAS, stage="fixture")
SCALE = Part("mg/g", _OWN, noun="scale factor", equation=_SCALED)
#: Of all axes together, as a bench's supply has it.
GAIN = Part(
    "mg/g",
    (sum(_OWN, ()),),
    noun="scale of all axes",
    equation=_SCALED,
    stage="fixture",
    shared=True,
)
ANGLES = Part("mg/g", _BELOW)
#: The angles and their mirror images: where directions are known, a turn of the triad shows too.
TILTS = Part("mg/g", _BELOW + _ABOVE)
#: Scale factors and angles.
MATRIX = Part("mg/g", _OWN + _BELOW, equation="y_i = x_i + {}")

INCLINATION = Part(
    "deg",
    axes=(inclination_axis,),
    equation="i = i_dial + {}",
    needs=("inclination", "tool_face"),
    stage="fixture",
)
TOOL_FACE = Part(
    "deg",
    axes=(tool_face_axis,),
    equation="t = t_dial + {}",
    needs=("tool_face",),
    stage="fixture",
)
#: How the tool stands in its clamp, about x, then y, then z; about its own axis alone.
CLAMP = Part("deg", axes=tuple(map(_of_tool, range(3))), needs=("tool_face",), stage="fixture")
CLAMP_Z = replace(CLAMP, axes=CLAMP.axes[2:])
#: How the triad stands in the tool.
MOUNTING = Part("deg", axes=CLAMP.axes, stage="mounting")
