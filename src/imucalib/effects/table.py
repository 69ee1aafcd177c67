"""The effects of a sensor at rest and of its bench: each row a part, and what it follows.

i_dial and t_dial count as the bench's dials do; a positive error is one towards a larger reading of
the dial.
"""

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import (
    Basis,
    Context,
    Effect,
    Parameter,
    Response,
    Rotation,
    Truth,
    own_axis,
    three,
)
from imucalib.core.references import unit_vector
from imucalib.effects.across import IEEE_1293, OCTANTS, monomial, polynomial
from imucalib.effects.forms import Bend, own_input
from imucalib.effects.parts import (
    ANGLES,
    BIAS,
    CLAMP,
    INCLINATION,
    MOUNTING,
    SCALE,
    TILTS,
    TOOL_FACE,
    Axis,
    Covariate,
    Part,
    Values,
    always,
    made,
    turned,
    waves,
)
from imucalib.units import MG, STANDARD_GRAVITY

#: mg/°C of a bias, twice the worst of data sheets; mg/g/°C of a scale.
USUAL_BIAS, _USUAL_SCALE = 2.0, 0.8

# A covariate's own zero is a constant, so that a subset keeps the parameters' meaning.
_TEMPERATURE = Covariate(
    ("temperature",),
    "follows the temperature",
    "c_i (T - 25 °C)",
    lambda context: context["temperature"] - 25.0,
    "Record the temperature; repeat positions at two temperatures, in mixed order.",
    per="/degC",
)
_ORDER = Covariate(
    ("order",),
    "moves steadily over the recording",
    "d_i (order - 1/2)",
    lambda context: context["order"] - 0.5,
    "Repeat a few positions at the end, and take the positions in random order.",
    tail=", order from 0 to 1",
)
_SETTLING = Covariate(
    ("order",),
    "settles exponentially from the start, within a quarter of the recording",
    "w_i exp(-4 order)",
    lambda context: np.asarray(np.exp(-4.0 * context["order"])),
    "Let the sensor warm up, or record its temperature.",
)
_SWEEP = Covariate(
    ("sweep",),
    "changes where a new sweep begins (a knock, a re-clamped tool)",
    "d_i [sweep > first]",
    lambda context: (context["sweep"] > 0.0).astype(float),
    "Repeat a position of the first sweep in the later ones.",
)
_DAY = Covariate(
    ("time_of_day",),
    "swings once a day",
    "c_i cos(φ) + s_i sin(φ)",
    lambda context: waves(context["time_of_day"]),
    "Record several days, and the temperature.",
    tail=",  φ = 2π time of day",
    labels=("cos", "sin"),
)
_NO_THERMOMETER = "stands in for the temperature where none was recorded"
_STRESS = "package stress; taken as a scale's change, as no data sheet states it"
_AT_TWO = "Record the temperature; repeat directions between the axes at two temperatures."


def _always(term: str, identify: str) -> Covariate:
    return Covariate((), "", term, always, identify)


_BOTH_SIGNS = "Show each axis both signs of gravity."

_BIASES = (
    made(
        "bias",
        BIAS,
        _always("b_i", _BOTH_SIGNS),
        "paper 004 eq. (3), p. 3; IEEE Std 1293 term K0",
        50.0,
        1000.0,
        sentence="Each axis reads a constant beside the specific force.",
    ),
    made(
        "temperature_bias",
        BIAS,
        _TEMPERATURE,
        "0.02-1 mg/°C in MEMS data sheets",
        0.5,
        usual=USUAL_BIAS,
    ),
    made(
        "temperature_scale",
        SCALE,
        _TEMPERATURE,
        "0.01-0.04 %/°C in MEMS data sheets",
        0.2,
        usual=_USUAL_SCALE,
    ),
    made("bias_drift", BIAS, _ORDER, "1 mg over a bench run, practice", 1.0),
    made(
        "scale_drift",
        SCALE,
        _ORDER,
        "0.1 % over a bench run, practice",
        1.0,
        remedy="its scale moves: let it warm up, check its supply, or leave it out",
    ),
    made("warm_up", BIAS, _SETTLING, "about 1 mg, practice", 1.0),
    made("bias_step", BIAS, _SWEEP, "1-20 mg after a knock, practice", 2.0),
    made("time_of_day", BIAS, _DAY, _NO_THERMOMETER, 0.3, 20.0, prefix="daily"),
    made("scale_by_time_of_day", SCALE, _DAY, _NO_THERMOMETER, 0.3, 20.0, prefix="daily_scale"),
)

_BEFORE = ("previous_x", "previous_y", "previous_z")
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
        own = unit * np.stack([context[name] for name in names], axis=-1)[:, None]
        return np.broadcast_to(own_axis(own), (*truth.shape, 3))

    return basis


_MEMORIES = (
    Response(
        "hysteresis",
        "The reading keeps a share of the previous position's.",
        "y_i = x_i + h_i x_i(previous position)",
        "about 1 mg/g, practice",
        "Approach some positions from both sides.",
        _BEFORE,
        each=three("hysteresis", "mg/g", 1.0, 30.0),
        basis=_each_axis(_BEFORE, 1e-3),
    ),
    Response(
        "approach_hysteresis",
        "The reading differs by the side from which an axis came to it.",
        "y_i = x_i + h_i sign(x_i - x_i(previous position))",
        "hysteresis between rising and falling input, IEEE Std 1293; about 1 mg, practice",
        "Approach some positions from both sides.",
        _SIDE,
        each=three("approach_hysteresis", "mg", 1.0, 30.0),
        basis=_each_axis(_SIDE, MG),
    ),
)


def _dial(
    name: str,
    part: Part,
    sentence: str,
    term: str,
    source: str,
    identify: str,
    values: Values,
    size: tuple[float, float] = (0.1, 5.0),
    *,
    needs: tuple[str, ...] = (),
    labels: tuple[str, ...] = ("",),
    unit: str = "deg",
) -> Effect:
    covariate = Covariate((*part.needs, *needs), "", term, values, identify, labels=labels)
    return made(name, part, covariate, source, *size, sentence=sentence, unit=unit)


def _wave_of(dial: str, order: int = 1) -> Values:
    def values(context: Context) -> Array:
        return waves(order * context.dial(dial))[:, ::-1]

    return values


_SIN_COS = ("sin", "cos")
_SWEEP_AT_BOTH = "Sweep the tool-face at inclinations of both signs."
_FULL_CIRCLE = "Turn the tool-face in equal steps over the full circle, twice."
_DISC = "0.06-0.11 deg for 25-100 µm on discs of 50-100 mm"

_INCLINATIONS = (
    _dial(
        "inclination_zero",
        INCLINATION,
        "The bench's inclination dial has its zero in the wrong place, or its base is tilted.",
        "d",
        "0.1 deg, practice; 1.4 deg on the table of paper 004",
        "Set inclinations of both signs; a spirit level on the base tells the two causes apart.",
        always,
        (0.5, 10.0),
    ),
    _dial(
        "inclination_scale",
        INCLINATION,
        "The inclination dial turns too far or not far enough, in proportion to the angle.",
        "k i_dial / 90 deg",
        "1 deg over a quarter turn, practice",
        "Set inclinations over a half turn, both signs.",
        lambda context: context.dial("inclination") / (np.pi / 2.0),
        (0.5, 10.0),
        unit="deg per 90 deg",
    ),
    _dial(
        "inclination_sag",
        INCLINATION,
        "The tool or its holder bends under its weight, most where it lies level.",
        "s cos i",
        "sag of assemblies in boreholes, ISCWSA; 0.1 deg on a bench, practice",
        "Support the tool near its sensor, and compare.",
        lambda context: np.cos(context["inclination"]),
    ),
    _dial(
        "inclination_eccentricity",
        INCLINATION,
        "The inclination dial is centred beside its axis.",
        "a sin i_dial + b (1 - cos i_dial)",
        _DISC,
        "Set inclinations over a full turn.",
        lambda context: _wave_of("inclination")(context) * [1.0, -1.0] + [0.0, 1.0],
        labels=_SIN_COS,
    ),
    _dial(
        "inclination_wobble",
        INCLINATION,
        "The rotary axis wobbles: the tool tips up and down once a turn.",
        "a sin t_dial + b cos t_dial",
        "0.06-0.11 deg for 50-100 µm on a seat of 50 mm",
        "Turn the tool-face in equal steps over the full circle at three inclinations.",
        _wave_of("tool_face"),
        labels=_SIN_COS,
    ),
    _dial(
        "inclination_backlash",
        INCLINATION,
        "The inclination lags behind the dial, by the side from which it was approached.",
        "b sign(approach)",
        "0.1 deg, practice",
        "Approach some settings from above and from below.",
        lambda context: context["inclination_approach"],
        needs=("inclination_approach",),
    ),
)

_SEATS = (
    made(
        "mounting",
        MOUNTING,
        _always(
            "", "Needs directions that are known in the tool's frame; gravity alone cannot show it."
        ),
        "paper 004 eq. (3): the three parameters that the full M has beyond eq. (4)",
        2.0,
        200.0,
        sentence="The sensor triad is turned in the tool; turns about x, then y, then z.",
        equation="x' = Rz(m_z) Ry(m_y) Rx(m_x) x",
    ),
    made(
        "clamp_creep",
        CLAMP,
        _ORDER,
        "0.1-1 deg where a clamp is soft or a bench settles, practice",
        0.3,
        20.0,
        sentence="The tool turns steadily in its clamp; turns about x, then y, then z.",
        equation="x' = Rz(c_z s) Ry(c_y s) Rx(c_x s) x,  s = order - 1/2, order from 0 to 1",
        identify="Return to the first positions at the end.",
    ),
)

_BETWEEN_AXES = (
    made(
        "non_orthogonality",
        ANGLES,
        _always("", "Hold the sensor in directions between its axes, in all octants."),
        "paper 002 eq. (1), K lower triangular; paper 004 eq. (4) by angles",
        0.02,
        0.3,
        unit="1",
        prefix="cross",
        sentence="The three sensing axes are not at right angles: y sees some x, z sees some x "
        "and y.",
        equation="y_y = x_y + k_yx x_x;  y_z = x_z + k_zx x_x + k_zy x_y",
    ),
    made(
        "temperature_non_orthogonality",
        ANGLES,
        _TEMPERATURE,
        _STRESS,
        0.2,
        usual=_USUAL_SCALE,
        prefix="temperature_cross",
        sentence="The angles between the sensing axes follow the temperature.",
        equation="y_y = x_y + c_yx x_x (T - 25 °C);  y_z = x_z + (c_zx x_x + c_zy x_y) (T - 25 °C)",
        identify=_AT_TWO,
    ),
    made(
        "temperature_misalignment",
        TILTS,
        _TEMPERATURE,
        _STRESS,
        0.2,
        usual=_USUAL_SCALE,
        prefix="temperature_tilt",
        sentence="Each sensing axis tilts with the temperature, towards both others.",
        equation="y_i = x_i + (c_ij x_j + c_ik x_k) (T - 25 °C)",
        identify=_AT_TWO,
        # The norm of a reading does not show the turn in it.
        part_of="temperature_non_orthogonality",
    ),
)


def _nonlinear(
    name: str, sentence: str, term: str, each: tuple[Parameter, ...], bend: Bend
) -> Response:
    words = (
        name,
        sentence,
        f"y_i = x_i + {term}",
        IEEE_1293,
        "Tilt finely between the axes, both signs of gravity on each axis.",
    )
    return own_input(words, "xyz", bend, each)


#: (axis that reads, axis that multiplies it): K_ip and K_io of IEEE Std 1293.
_PRODUCTS = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))

_NONLINEARITIES = (
    _nonlinear(
        "quadratic",
        "The response has a square term.",
        "K2_i x_i²",
        three("quadratic", "mg/g2", 3.0, 60.0),
        Bend(lambda u: u[..., None] ** 2, lambda u: 2.0 * u[..., None]),
    ),
    _nonlinear(
        "cubic",
        "The response has a cubic term.",
        "K3_i x_i³",
        three("cubic", "mg/g3", 3.0, 60.0),
        Bend(lambda u: u[..., None] ** 3, lambda u: 3.0 * u[..., None] ** 2),
    ),
    _nonlinear(
        "asymmetry",
        "The scale differs between the positive and the negative half of an axis.",
        "k_i |x_i|",
        three("asymmetry", "mg/g", 2.0, 40.0),
        Bend(lambda u: np.abs(u[..., None]), lambda u: np.sign(u[..., None])),
    ),
    polynomial(
        (
            "cross_axis",
            "The scale of an axis depends on the force across it.",
            "y_i = x_i + Σ_j K_ij x_i x_j,  j ≠ i",
            f"{IEEE_1293} (K_ip, K_io)",
            OCTANTS,
        ),
        tuple((i, ((1.0, monomial(i, j)),)) for i, j in _PRODUCTS),
        tuple(
            Parameter(f"cross_axis_{'xyz'[i]}{'xyz'[j]}", "mg/g2", 3.0, 60.0) for i, j in _PRODUCTS
        ),
    ),
    made(
        "scale",
        SCALE,
        _always("", _BOTH_SIGNS),
        "paper 004 eq. (3), p. 3; IEEE Std 1293 term K1",
        0.03,
        0.5,
        unit="1",
        sentence="Each axis multiplies the specific force by its own factor.",
        equation="y_i = (1 + s_i) x_i",
    ),
)


def _base_axis(context: Context) -> Array:
    """Across the force and the inclination axis."""
    return -unit_vector(context["inclination"] + np.pi / 2.0, context["tool_face"])


def _square_to_both(context: Context) -> Array:
    t = context["tool_face"]
    return np.stack([np.sin(t), np.cos(t), np.zeros_like(t)], axis=-1)


def _table_axis(axis: Axis) -> Part:
    return replace(INCLINATION, equation="", axes=(axis,))


def _later_sweeps(context: Context) -> Array:
    return np.asarray(context["sweep"][:, None] == np.arange(1, context.sweeps), np.float64)


def _sweep_parameters(context: Context) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(f"tool_face_zero_sweep_{sweep + 1}", "deg", 0.3, 10.0)
        for sweep in range(1, context.sweeps)
    )


_AXES_OF_THE_TABLE = (
    made(
        "base_tilt_across",
        _table_axis(_base_axis),
        _always("", _SWEEP_AT_BOTH),
        "0.1 deg, practice",
        0.1,
        5.0,
        sentence="The base is tilted along the inclination axis, so that gravity has a part along "
        "it.",
        equation="x' = x cos e + g e_axis sin e, e_axis along the inclination axis",
    ),
    made(
        "axis_non_orthogonality",
        _table_axis(_square_to_both),
        _always("", _SWEEP_AT_BOTH),
        "0.1 deg; a good stage 0.005 deg (NIST, Geist and Gaitan 2021)",
        0.1,
        5.0,
        sentence="The rotary axis is not square to the inclination axis.",
        equation="x' = R(h about the direction square to both axes) x",
    ),
)

_TOOL_FACES = (
    _dial(
        "tool_face_zero",
        TOOL_FACE,
        "The tool-face dial has its zero in the wrong place.",
        "d",
        "0.3 deg, practice",
        "Absorbed by the mounting of the sensor; an independent scribe-line measurement shows it.",
        always,
        (0.3, 10.0),
    ),
    Rotation(
        "tool_face_zero_per_sweep",
        "The tool-face zero moved where a new sweep began.",
        "t = t_dial + d_sweep, none in the first",
        "0.3 deg, practice",
        "Repeat a tool-face of the first sweep in the later ones.",
        ("tool_face", "sweep"),
        named=_sweep_parameters,
        turns=turned(TOOL_FACE.axes, _later_sweeps),
    ),
    _dial(
        "tool_face_eccentricity",
        TOOL_FACE,
        "The tool-face dial is centred beside its axis.",
        "a sin t_dial + b cos t_dial",
        _DISC,
        _FULL_CIRCLE,
        _wave_of("tool_face"),
        labels=_SIN_COS,
    ),
    _dial(
        "tool_face_ellipticity",
        TOOL_FACE,
        "The tool-face error repeats twice a turn (oval disc, coupling).",
        "a sin 2t_dial + b cos 2t_dial",
        _DISC,
        _FULL_CIRCLE,
        _wave_of("tool_face", 2),
        labels=_SIN_COS,
    ),
    _dial(
        "tool_face_backlash",
        TOOL_FACE,
        "The tool-face lags behind the dial, by the side from which it was approached.",
        "b sign(approach)",
        "0.1 deg, practice",
        "Approach some settings from both sides.",
        lambda context: context["tool_face_approach"],
        needs=("tool_face_approach",),
    ),
)

EFFECTS: tuple[Effect, ...] = (
    *_BIASES,
    *_MEMORIES,
    *_INCLINATIONS,
    *_SEATS,
    *_BETWEEN_AXES,
    *_NONLINEARITIES,
    *_AXES_OF_THE_TABLE,
    *_TOOL_FACES,
)
