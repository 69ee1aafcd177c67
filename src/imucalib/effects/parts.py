"""What of a sensor or its bench changes, and what that follows: effects are made of the two.

A sensor's part is columns of pairs (axis that reads, axis whose force it reads): bias, scale
factors, angles between axes. A bench's part is axes of rotation: a dial, the seat of a tool. What
it follows is a covariate of the context, with one column or several. The parameters multiply both.
"""

import re
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import (
    Basis,
    Context,
    Effect,
    EffectScan,
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
_OWN: tuple[Column, ...] = (((0, 0),), ((1, 1),), ((2, 2),))
#: y sees x, z sees x, z sees y: x keeps its direction.
_BELOW: tuple[Column, ...] = (((1, 0),), ((2, 0),), ((2, 1),))
_ABOVE: tuple[Column, ...] = (((0, 1),), ((0, 2),), ((1, 2),))
_ON_BENCH = ("inclination", "tool_face")


@dataclass(frozen=True)
class EffectPart:
    """columns : of a sensor's part; axes : of a bench's, turned about one after the other
    needs : covariates without which there is no such part; shared : by all triads
    """

    columns: tuple[Column, ...] = ()
    axes: tuple[Axis, ...] = ()
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
    """needs : names of the context; labels : of the columns of its values, where there are more
    than one"""

    needs: tuple[str, ...]
    values: Values
    labels: tuple[str, ...] = ("",)


@cache
def entries() -> dict[str, dict[str, Any]]:
    """What `catalogue.toml` has of effects by name, of a scan's members by its name and an @."""
    return tomllib.loads(files(__package__).joinpath("catalogue.toml").read_text("utf-8"))


def words(key: str, value: str = "", **given: object) -> tuple[str, str, str, str, str]:
    """Name, sentence, equation, source and how to identify it, as `Described` has them; value : of
    a scan's member; given : what its words leave open"""
    entry, name = entries()[key], f"{key.partition('@')[0]}@{value}" if value else key
    fields = ("sentence", "equation", "source", "identify")
    sentence, equation, source, identify = (entry[field].format(**given) for field in fields)
    return name, sentence, equation, source, identify


def sizes(key: str, labels: Iterable[str], value: str = "") -> tuple[Parameter, ...]:
    """Parameters with these labels, named after the effect or what it has for a prefix."""
    entry = entries()[key]
    prefix = entry.get("prefix", key.partition("@")[0]), re.sub("[@:]", "_", value)
    return tuple(
        Parameter("_".join(filter(None, (*prefix, label))), **entry["size"]) for label in labels
    )


def make_effect(
    key: str, part: EffectPart, covariate: Covariate, value: str = "", **given: object
) -> Response | Rotation:
    """The effect: a part that follows a covariate; key, value, given : as `words` takes them"""
    labels = [
        "_".join(filter(None, (term, label))) for term in covariate.labels for label in part.labels
    ]
    needs = tuple(dict.fromkeys((*covariate.needs, *part.needs)))
    texts, parameters = (*words(key, value, **given), needs), sizes(key, labels, value)
    if part.axes:
        turns = turn_axes(part.axes, covariate.values)
        return Rotation(*texts, named=parameters, turns=turns, stage=part.stage)
    basis, basis_dx = linear(part.columns, covariate.values, parameters[0].unit)
    return Response(
        *texts,
        each=parameters,
        basis=basis,
        basis_dx=basis_dx,
        stage=part.stage,
        shared=part.shared,
        part_of=entries()[key].get("part_of", ""),
        remedy=entries()[key].get("remedy", ""),
    )


def scan(
    name: str,
    member: Callable[[str], Effect],
    values: Callable[[Context], tuple[str, ...]],
    nearby: Callable[[Context, str], tuple[str, ...]] = lambda context, text: (),
    *,
    unfounded: bool = False,
    free: bool = False,
) -> EffectScan:
    """The family of members, as `EffectScan` has it."""
    entry = entries()[f"{name}@"]
    shown, example = entry["shown"], entry["example"]
    return EffectScan(name, shown, example, member, values, nearby, unfounded=unfounded, free=free)


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


def turn_axes(axes: tuple[Axis, ...], values: Values) -> tuple[Turn, ...]:
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


BIAS = EffectPart((((0, None),), ((1, None),), ((2, None),)))
#: The same of the room and not of the sensor: no recording has its phase.
ROOM_BIAS = replace(BIAS, stage="fixture")
SCALE = EffectPart(_OWN)
#: Of all axes together, as a bench's supply has it.
GAIN = EffectPart((((0, 0), (1, 1), (2, 2)),), stage="fixture", shared=True)
ANGLES = EffectPart(_BELOW)
#: The angles and their mirror images: where directions are known, a turn of the triad shows too.
TILTS = EffectPart(_BELOW + _ABOVE)
#: Scale factors and angles.
MATRIX = EffectPart(_OWN + _BELOW)

INCLINATION = EffectPart(axes=(inclination_axis,), needs=_ON_BENCH, stage="fixture")
TOOL_FACE = EffectPart(axes=(tool_face_axis,), needs=("tool_face",), stage="fixture")
#: How the tool stands in its clamp, about x, then y, then z; about its own axis alone.
CLAMP = EffectPart(axes=tuple(map(_of_tool, range(3))), needs=("tool_face",), stage="fixture")
CLAMP_Z = replace(CLAMP, axes=CLAMP.axes[2:])
