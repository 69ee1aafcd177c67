"""The effects of a sensor at rest and of its bench: a part, and what it follows.

What is said of each, and its sizes, stand in `catalogue.toml`.
"""

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import (
    Context,
    Effect,
    Parameter,
    Response,
    Rotation,
    Truth,
    Turned,
    own_axis,
)
from imucalib.core.references import unit_vector
from imucalib.effects.across import monomial, polynomial
from imucalib.effects.forms import Bend, own_input
from imucalib.effects.parts import (
    ANGLES,
    BIAS,
    CLAMP,
    INCLINATION,
    SCALE,
    TILTS,
    TOOL_FACE,
    Covariate,
    Values,
    always,
    make_effect,
    sizes,
    turn_axes,
    waves,
    words,
)
from imucalib.units import MG, STANDARD_GRAVITY

# A covariate's own zero is a constant, so that a subset keeps the parameters' meaning.
_ALWAYS = Covariate((), always)
_TEMPERATURE = Covariate(("temperature",), lambda context: context["temperature"] - 25.0)
_ORDER = Covariate(("order",), lambda context: context["order"] - 0.5)
_SETTLING = Covariate(("order",), lambda context: np.asarray(np.exp(-4.0 * context["order"])))
_SWEEP = Covariate(("sweep",), lambda context: (context["sweep"] > 0.0).astype(float))
_DAY = Covariate(
    ("time_of_day",), lambda context: waves(context["time_of_day"]), labels=("cos", "sin")
)

_BEFORE = ("previous_x", "previous_y", "previous_z")
_SIDE = ("approach_x", "approach_y", "approach_z")
#: m/s², a smaller move of an axis has no side.
_MOVED = 0.02 * STANDARD_GRAVITY
_SIN_COS = ("sin", "cos")
#: (axis that reads, axis that multiplies it): K_ip and K_io of IEEE Std 1293.
_PRODUCTS = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))


def covariates_before(reading: Array) -> dict[str, Array]:
    """Of rests (n, 3) m/s² in order of time each axis' reading before (n,) m/s², and the side from
    which it came (n,), -1, 0 or 1; the first stands for what was before it."""
    before = np.concatenate([reading[:1], reading[:-1]])
    moved = reading - before
    side = np.sign(moved) * (np.abs(moved) > _MOVED)
    return dict(zip((*_BEFORE, *_SIDE), (*before.T, *side.T), strict=True))


def _memory(key: str, names: tuple[str, ...], unit: float) -> Response:
    """What of each axis its own covariate leaves, in this unit."""

    def basis(truth: Truth, context: Context) -> Array:
        own = unit * np.stack([context[name] for name in names], axis=-1)[:, None]
        return np.broadcast_to(own_axis(own), (*truth.shape, 3))

    return Response(*words(key), names, each=sizes(key, "xyz"), basis=basis)


def _dial(key: str, values: Values, *more: str, labels: tuple[str, ...] = ("",)) -> Effect:
    """An error of the dial whose name the key begins with; more : covariates that it needs"""
    part = TOOL_FACE if key.startswith("tool_face") else INCLINATION
    return make_effect(key, part, Covariate((*part.needs, *more), values, labels))


def _waves_of(dial: str, order: int = 1) -> Values:
    return lambda context: waves(order * context.dial(dial))[:, ::-1]


def _base_axis(context: Context) -> Array:
    """Across the force and the inclination axis."""
    return -unit_vector(context["inclination"] + np.pi / 2.0, context["tool_face"])


def _square_to_both(context: Context) -> Array:
    """Across the rotary and the inclination axis."""
    t = context["tool_face"]
    return np.stack([np.sin(t), np.cos(t), np.zeros_like(t)], axis=-1)


def _later_sweeps(context: Context) -> Array:
    return np.asarray(context["sweep"][:, None] == np.arange(1, context.sweeps), np.float64)


def _sweep_parameters(context: Context) -> tuple[Parameter, ...]:
    return sizes("tool_face_zero_per_sweep", (str(k + 1) for k in range(1, context.sweeps)))


EFFECTS: tuple[Effect, ...] = (
    make_effect("bias", BIAS, _ALWAYS),
    make_effect("temperature_bias", BIAS, _TEMPERATURE),
    make_effect("temperature_scale", SCALE, _TEMPERATURE),
    make_effect("bias_drift", BIAS, _ORDER),
    make_effect("scale_drift", SCALE, _ORDER),
    make_effect("warm_up", BIAS, _SETTLING),
    make_effect("bias_step", BIAS, _SWEEP),
    make_effect("time_of_day", BIAS, _DAY),
    make_effect("scale_by_time_of_day", SCALE, _DAY),
    _memory("hysteresis", _BEFORE, 1e-3),
    _memory("approach_hysteresis", _SIDE, MG),
    _dial("inclination_zero", always),
    _dial("inclination_scale", lambda context: context.dial("inclination") / (np.pi / 2.0)),
    _dial("inclination_sag", lambda context: np.asarray(np.cos(context["inclination"]))),
    _dial(
        "inclination_eccentricity",
        lambda context: _waves_of("inclination")(context) * [1.0, -1.0] + [0.0, 1.0],
        labels=_SIN_COS,
    ),
    _dial("inclination_wobble", _waves_of("tool_face"), labels=_SIN_COS),
    _dial(
        "inclination_backlash",
        lambda context: context["inclination_approach"],
        "inclination_approach",
    ),
    Turned(*words("mounting"), (), each=sizes("mounting", "xyz")),
    make_effect("clamp_creep", CLAMP, _ORDER),
    make_effect("non_orthogonality", ANGLES, _ALWAYS),
    make_effect("temperature_non_orthogonality", ANGLES, _TEMPERATURE),
    # The norm of a reading does not show the turn in it.
    make_effect("temperature_misalignment", TILTS, _TEMPERATURE),
    own_input(
        words("quadratic"),
        "xyz",
        Bend(lambda u: u[..., None] ** 2, lambda u: 2.0 * u[..., None]),
        sizes("quadratic", "xyz"),
    ),
    own_input(
        words("cubic"),
        "xyz",
        Bend(lambda u: u[..., None] ** 3, lambda u: 3.0 * u[..., None] ** 2),
        sizes("cubic", "xyz"),
    ),
    own_input(
        words("asymmetry"),
        "xyz",
        Bend(lambda u: np.abs(u[..., None]), lambda u: np.sign(u[..., None])),
        sizes("asymmetry", "xyz"),
    ),
    polynomial(
        "cross_axis",
        tuple((i, ((1.0, monomial(i, j)),)) for i, j in _PRODUCTS),
        ("xyz"[i] + "xyz"[j] for i, j in _PRODUCTS),
    ),
    make_effect("scale", SCALE, _ALWAYS),
    make_effect("base_tilt_across", replace(INCLINATION, axes=(_base_axis,)), _ALWAYS),
    make_effect("axis_non_orthogonality", replace(INCLINATION, axes=(_square_to_both,)), _ALWAYS),
    _dial("tool_face_zero", always),
    Rotation(
        *words("tool_face_zero_per_sweep"),
        ("tool_face", "sweep"),
        named=_sweep_parameters,
        turns=turn_axes(TOOL_FACE.axes, _later_sweeps),
    ),
    _dial("tool_face_eccentricity", _waves_of("tool_face"), labels=_SIN_COS),
    _dial("tool_face_ellipticity", _waves_of("tool_face", 2), labels=_SIN_COS),
    _dial(
        "tool_face_backlash", lambda context: context["tool_face_approach"], "tool_face_approach"
    ),
)
