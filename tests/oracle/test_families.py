"""Members of families (curves, forms, steps, lags) against their printed equations, written a
second time with numpy alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from imucalib.core.effect import Context, Truth
from imucalib.effects import families, named
from imucalib.effects.forms import FORMS
from imucalib.units import DEG, MG, STANDARD_GRAVITY
from oracle.equations import PAGE

N = 60
#: kind -> (equation as printed, the columns that its sizes multiply, of u and the form's numbers).
FORMULAS: dict[str, tuple[str, Callable[..., list[np.ndarray]]]] = {
    "sine": (
        "a sin(2π u / P) + b cos(2π u / P), P = {0}",
        lambda u, p: [np.sin(2 * np.pi * u / p), np.cos(2 * np.pi * u / p)],
    ),
    "power": ("a ((u - {1}) / {2})^{0}", lambda u, n, m, r: [((u - m) / r) ** n]),
    "kink": ("a |u - {0}|", lambda u, c: [np.where(u < c, c - u, u - c)]),
    "step": ("a [u >= {0}]", lambda u, c: [np.where(u < c, 0.0, 1.0)]),
    "odd_power": (
        "a sign(u) |u|^{0}",
        lambda u, c: [np.where(u < 0, -1.0, 1.0) * np.exp(c * np.log(np.abs(u)))],
    ),
    "even_power": ("a |u|^{0}", lambda u, c: [np.exp(c * np.log(np.abs(u)))]),
    "saturation": (
        "a sign(u) max(|u| - {0}, 0) / (1 - {0})",
        lambda u, c: [np.select([u > c, u < -c], [u - c, u + c], 0.0) / (1 - c)],
    ),
    "soft_saturation": (
        "a sign(u) max(|u| - {0}, 0)² / (1 - {0})²",
        lambda u, c: [np.select([u > c, u < -c], [(u - c) ** 2, -((u + c) ** 2)]) / (1 - c) ** 2],
    ),
    "saw_tooth": (
        "a ((u / {0} + {1}) mod 1 - 1/2)",
        lambda u, p, s: [u / p + s - np.floor(u / p + s) - 0.5],
    ),
    "exponential": (
        "a exp(-max((u - {1}) / {0}, 0))",
        lambda u, s, m: [np.where((u - m) / s > 0.0, np.exp(-(u - m) / s), 1.0)],
    ),
}
#: kind -> numbers of a form of an axis' input in g, and of one of a temperature in °C.
NUMBERS = {
    "sine": ("0.7", "9"), "power": ("4:0.1:0.8", "3:25:15"), "kink": ("0.3", "22"),
    "odd_power": ("1.5", "1.5"), "even_power": ("1.5", "1.5"),
    "step": ("0.2", "24"), "saturation": ("0.6", ""), "soft_saturation": ("0.4", ""),
    "saw_tooth": ("0.3:0.1", "7:0.2"), "exponential": ("0.4:-1", "8:12"),
}  # fmt: skip


def world(seed: int = 3) -> tuple[np.ndarray, Context]:
    """Specific force (N, 3) in g, and what goes with it."""
    rng = np.random.default_rng(seed)
    covariates = {
        "temperature": rng.uniform(10, 40, N), "order": rng.uniform(0, 1, N),
        "time": np.arange(N) * 60.0, "record": np.arange(float(N)),
        "tool_face": rng.uniform(0, 2 * np.pi, N), "inclination": rng.uniform(-1.5, 1.5, N),
        **{f"temperature_lag_{value}": rng.uniform(10, 40, N) for value in ("2h", "4rows")},
        "temperature_play_3C": rng.uniform(10, 40, N),
        **{f"temperature_rate_{v}": rng.uniform(-5, 5, N) for v in ("12min", "3rows")},
    }  # fmt: skip
    return rng.uniform(-1.0, 1.0, (N, 3)), Context(N, covariates)


def added(name: str, theta: np.ndarray, force: np.ndarray, context: Context) -> np.ndarray:
    """What an effect adds, (N, 3) in g."""
    truth = Truth(STANDARD_GRAVITY * force[:, None])
    return named(name).act(theta, truth, context).delta[:, 0] / STANDARD_GRAVITY


def test_every_form_stands_here_as_it_is_printed() -> None:
    assert {kind: form.equation for kind, form in FORMS.items()} == {
        kind: equation for kind, (equation, _) in FORMULAS.items()
    }


@pytest.mark.parametrize("kind", FORMS)
def test_a_form_of_the_input(kind: str) -> None:
    force, context = world()
    name = f"shape@response:xz:{kind}:{NUMBERS[kind][0]}"
    theta = np.random.default_rng(4).normal(size=len(named(name).parameters(context)))
    numbers = [float(n) for n in NUMBERS[kind][0].split(":")]
    expected = np.zeros_like(force)
    for axis, sizes in zip((0, 2), np.split(theta, 2), strict=True):
        columns = FORMULAS[kind][1](force[:, axis], *numbers)
        expected[:, axis] = 1e-3 * sum(s * c for s, c in zip(sizes, columns, strict=True))
    np.testing.assert_allclose(added(name, theta, force, context), expected, atol=1e-12)


@pytest.mark.parametrize("kind", FORMS)
def test_the_slope_of_a_form_is_its_difference(kind: str) -> None:
    """By the input, where neither end of the difference is beyond a corner."""
    force, context = world()
    effect = named(f"shape@response:xyz:{kind}:{NUMBERS[kind][0]}")
    theta = np.random.default_rng(7).normal(size=len(effect.parameters(context)))

    def delta(off: float) -> np.ndarray:
        truth = Truth(STANDARD_GRAVITY * (force + off)[:, None])
        return effect.act(theta, truth, context).delta[:, 0] / STANDARD_GRAVITY

    slope = effect.act(theta, Truth(STANDARD_GRAVITY * force[:, None]), context).d_x[:, 0]
    assert np.count_nonzero(slope - slope * np.eye(3)) == 0
    numeric = (delta(1e-6) - delta(-1e-6)) / 2e-6
    smooth = np.abs(delta(2e-6) - 2 * delta(0.0) + delta(-2e-6)) < 1e-11
    assert smooth.mean() > 0.9
    np.testing.assert_allclose(slope[:, range(3), range(3)][smooth], numeric[smooth], atol=1e-7)


@pytest.mark.parametrize("kind", [kind for kind in FORMS if NUMBERS[kind][1]])
def test_a_form_of_the_temperature(kind: str) -> None:
    force, context = world()
    name = f"shape@bias:temperature:{kind}:{NUMBERS[kind][1]}"
    theta = np.random.default_rng(5).normal(size=len(named(name).parameters(context)))
    numbers = [float(n) for n in NUMBERS[kind][1].split(":")]
    columns = FORMULAS[kind][1](context["temperature"], *numbers)
    expected = 1e-3 * np.stack(columns, axis=1) @ theta.reshape(3, -1).T
    np.testing.assert_allclose(added(name, theta, force, context), expected, atol=1e-12)


def test_a_scale_against_time_swings_jumps_and_moves_by_axis() -> None:
    """The reading of an axis grows by a share of itself, in thousandths; the rougher waves of a
    course are the smaller ones."""
    force, context = world()
    time, theta = context["time"], np.random.default_rng(6).normal(size=6)
    waves = np.stack([np.sin(2 * np.pi * time / 900.0), np.cos(2 * np.pi * time / 900.0)], axis=1)
    got = added("shape@scale:time:sine:900", theta, force, context)
    np.testing.assert_allclose(got, 1e-3 * force * (waves @ theta.reshape(3, 2).T), atol=1e-12)
    late = np.where(time < 1200.0, 0.0, 1.0)[:, None]
    got = added("shape@scale:time:step:1200", theta[:3], force, context)
    np.testing.assert_allclose(got, 1e-3 * force * late * theta[:3], atol=1e-12)
    for what in ("bias", "scale"):
        sizes = [p.typical for p in named(f"curve@{what}:time:0:3540:4").parameters(context)]
        np.testing.assert_allclose(sizes, [1.0, 1 / 2, 1 / 3, 1 / 4] * 3)


def test_a_form_of_an_angle_is_in_degrees() -> None:
    """Tool-face read too small by 0.3 deg sin(2π t / 120°) + 0.2 deg cos(...): gravity turns by
    it about the tool's axis. See the convention of tool_face_zero for the sense."""
    force, context = world()
    theta = np.array([0.3, 0.2])
    phase = 2 * np.pi * np.degrees(context["tool_face"]) / 120.0
    angle = DEG * (0.3 * np.sin(phase) + 0.2 * np.cos(phase))
    plain = np.stack([added("tool_face_zero", np.array([a / DEG]), force, context)[k]
                      for k, a in enumerate(angle)])  # fmt: skip
    got = added("shape@tool_face:tool_face:sine:120", theta, force, context)
    np.testing.assert_allclose(got, plain, atol=1e-12)


def test_a_curve_of_the_input_has_no_bias_and_no_scale() -> None:
    """Cosines, u from 0 at -1.06 g to 1 at 1.06 g, less the line that fits them best over the even
    inputs of a sphere."""
    force, context = world()
    theta = np.array([2.0, -1.0, 0.5])

    def cosines(x: np.ndarray) -> np.ndarray:
        return sum(c * np.cos(k * np.pi * (x / 1.06 + 1.0) / 2.0) for k, c in enumerate(theta, 2))

    x = (np.arange(200_000) + 0.5) / 100_000 - 1.0
    line = np.polynomial.Polynomial.fit(x, cosines(x), 1, domain=[-1.0, 1.0])
    expected = np.zeros_like(force)
    expected[:, 1] = 1e-3 * (cosines(force[:, 1]) - line(force[:, 1]))
    got = added("curve@response:y:-1:1:3", theta, force, context)
    np.testing.assert_allclose(got, expected, atol=1e-12)


def test_a_curve_of_a_covariate_goes_on_beyond_its_ends() -> None:
    """u from 0 to 1 over the recorded range, 15 to 30 °C; outside by slopes of its own."""
    force, context = world()
    theta = np.array([1.0, 2.0, 0.7, -0.4, 0.0, 0.0, 0.2, 0.3, -3.0, 0.5, 0.0, 1.0])
    u = (context["temperature"] - 15.0) / 15.0
    assert u.min() < 0.0
    assert u.max() > 1.0
    inside = np.clip(u, 0.0, 1.0)
    ends = [np.where(u < 0.0, -u, 0.0), np.where(u > 1.0, u - 1.0, 0.0)]
    waves = [np.cos(np.pi * inside), np.cos(2 * np.pi * inside)]
    columns = np.stack([*waves, *(np.pi * e for e in ends)], axis=1)
    got = added("curve@bias:temperature:15:30:2", theta, force, context)
    np.testing.assert_allclose(got, 1e-3 * columns @ theta.reshape(3, 4).T, atol=1e-12)


def test_a_curve_of_the_tool_face_closes() -> None:
    """Sines and cosines of whole turns, as its equation says; an odd count is made even."""
    force, context = world()
    t = context["tool_face"]
    theta = np.random.default_rng(6).normal(size=12)
    columns = np.stack([np.sin(t), np.sin(2 * t), np.cos(t), np.cos(2 * t)], axis=1)
    for terms in (3, 4):
        effect = named(f"curve@bias:tool_face:0:6.2832:{terms}")
        assert effect.equation == "y_i = x_i + Σ_k a_k sin(k t) + b_k cos(k t)"
        got = effect.act(theta, Truth(STANDARD_GRAVITY * force[:, None]), context).delta[:, 0]
        np.testing.assert_allclose(got / MG, columns @ theta.reshape(3, 4).T, atol=1e-9)


#: member -> what each axis' parameter, in thousandths of g, is multiplied by, of the force in g and
#: what is known of a reading; the reading that is taken at a step is behind it.
COURSES: dict[str, Callable[[np.ndarray, Context], np.ndarray]] = {
    "thermal_lag@2h": lambda x, k: k["temperature_lag_2h"] - 25.0,
    "thermal_lag@4rows": lambda x, k: k["temperature_lag_4rows"] - 25.0,
    "thermal_hysteresis@3C": lambda x, k: k["temperature_play_3C"] - 25.0,
    "temperature_rate@12min": lambda x, k: k["temperature_rate_12min"],
    "temperature_rate@3rows": lambda x, k: k["temperature_rate_3rows"],
    "temperature_square@22.5C": lambda x, k: (k["temperature"] - 22.5) ** 2,
    "bias_step@1200s": lambda x, k: np.arange(N) >= 20,
    "scale_step@record12": lambda x, k: (np.arange(N) >= 11) * x.T,
}


@pytest.mark.parametrize("name", COURSES)
def test_an_axis_follows_its_course(name: str) -> None:
    force, context = world()
    theta = np.array([0.5, -1.0, 2.0])
    course = np.broadcast_to(COURSES[name](force, context), (3, N)).T
    got = added(name, theta, force, context)
    np.testing.assert_allclose(got, 1e-3 * theta * course, atol=1e-12)


def test_a_third_degree_is_harmonic_and_of_one_size() -> None:
    """Its seven products hold nothing of the first and second degree over the sphere, nor of each
    other; and a product of the page is one of them."""
    rng = np.random.default_rng(0)
    force = rng.normal(size=(40_000, 3))
    force /= np.linalg.norm(force, axis=1, keepdims=True)
    context = Context(len(force))
    columns = np.stack(
        [added("third_degree@z", one, force, context)[:, 2] for one in 1e3 * np.eye(7)], axis=1
    )
    np.testing.assert_allclose(columns.T @ columns / len(force), np.eye(7) / 7.0, atol=5e-3)
    low = np.column_stack([np.ones(len(force)), force, force**2, force * np.roll(force, 1, axis=1)])
    np.testing.assert_allclose(low.T @ columns / len(force), 0.0, atol=8e-3)
    x, y, z = force.T
    np.testing.assert_allclose(columns[:, 0], x * (2 * x**2 - 3 * y**2 - 3 * z**2) / 2, atol=1e-9)
    np.testing.assert_allclose(columns[:, 4], 15**0.5 * y * (z**2 - x**2) / 2, atol=1e-9)
    np.testing.assert_allclose(columns[:, 6], 15**0.5 * x * y * z, atol=1e-9)
    context = world()[1]
    assert families()["third_degree"].values(context) == ("x", "y", "z")
    assert families()["third_degree"].values(context.take(np.arange(23))) == ()


def test_a_turning_point_is_tried_within_the_range_of_the_temperature() -> None:
    """At its quarters, to a degree; near the best one to a fifth of it."""
    scan = families()["temperature_square"]
    context = Context(40, {"temperature": np.linspace(10.2, 30.2, 40)})
    assert scan.values(context) == ("15C", "20C", "25C")
    near = scan.nearby(context, "20C")
    assert (near[0], near[1], near[-1]) == ("15C", "15.2C", "25C")
    assert scan.values(Context(40)) == ()
    two = np.where(np.arange(40) < 20, 20.0, 30.0) + np.tile([-0.5, 0.5], 20)
    assert scan.values(Context(40, {"temperature": two})) == ()  # as good as a line
    assert scan.values(Context(40, {"temperature": np.linspace(20.1, 20.4, 40)})) == ()


def test_a_tool_that_slipped_stands_turned_from_then_on() -> None:
    """About x, then y, then z, right-handed; its dials alone show it."""
    force, context = world()
    theta = np.array([3.0, -5.0, 8.0])
    turned = force
    for axis, deg in zip(np.eye(3), theta, strict=True):
        angle = np.deg2rad(deg)
        along = (turned @ axis)[:, None] * axis
        turned = along + np.cos(angle) * (turned - along) + np.sin(angle) * np.cross(axis, turned)
    expected = np.where(np.arange(N)[:, None] >= 11, turned - force, 0.0)
    np.testing.assert_allclose(added("slip@record12", theta, force, context), expected, atol=1e-12)
    own = added("slip@record12", theta * [0.0, 0.0, 1.0], force, context)
    np.testing.assert_allclose(added("slip@record12:z", theta[2:], force, context), own, atol=1e-12)
    for name in ("slip", "scale_step", "inclination_step"):
        values, bare = families()[name].values, {"record": np.arange(14.0)}
        without_dials = values(Context(14, bare))
        assert bool(without_dials) is (name == "scale_step")
        assert values(Context(14, bare | {"time": np.arange(14.0)})) == ()
        dials = {"record": np.arange(14.0), "tool_face": np.zeros(14), "time": np.arange(14.0)}
        tried = tuple(r for r in values(Context(14, dials)) if not r.endswith(":z"))
        assert tried == ("record7", "record8", "record9")
    assert [r for r in families()["slip"].values(Context(14, dials)) if r.endswith(":z")] == [
        "record7:z", "record8:z", "record9:z",
    ]  # fmt: skip


def test_a_dial_whose_zero_moved_raises_every_inclination_from_then_on() -> None:
    """A positive step raises the tool towards its own axis, whatever the tool-face."""
    _, context = world()
    i, t = context["inclination"], context["tool_face"]
    later = i + np.where(np.arange(N) >= 11, np.deg2rad(2.0), 0.0)

    def force(i: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=1)

    got = added("inclination_step@record12", np.array([2.0]), force(i), context)
    np.testing.assert_allclose(got, force(later) - force(i), atol=1e-12)


def test_a_cycle_swings_with_its_period_in_rows() -> None:
    """Counted from the first row, whatever rows are left; of forty rows from a swing and a half to
    two in five rows."""
    force, context = world()
    theta = np.random.default_rng(8).normal(size=6)
    phase = 2 * np.pi * np.arange(N)[:, None] / 7.3
    expected = 1e-3 * (theta[:3] * np.cos(phase) + theta[3:] * np.sin(phase))
    np.testing.assert_allclose(added("cycle@7.3rows", theta, force, context), expected, atol=1e-12)
    some = context.take(np.arange(20, 50))
    np.testing.assert_allclose(
        added("cycle@7.3rows", theta, force[20:50], some), expected[20:50], atol=1e-12
    )
    dials = {"record": np.arange(40.0), "tool_face": np.zeros(40)}
    family = families()["cycle"]
    tried = [40.0 / float(v.removesuffix("rows")) for v in family.values(Context(40, dials))]
    np.testing.assert_allclose(tried, np.arange(1.5, 16.0, 0.5), rtol=1e-3)
    near = [float(v.removesuffix("rows")) for v in family.nearby(Context(40, dials), "8rows")]
    np.testing.assert_allclose(40.0 / np.array(near), np.linspace(4.5, 5.5, 11), rtol=1e-3)
    assert family.values(Context(40, {"record": np.arange(40.0)})) == ()
    assert family.values(Context(19, {k: v[:19] for k, v in dials.items()})) == ()


def test_a_scale_swings_with_its_period_alike_on_all_axes() -> None:
    force, context = world()
    theta = np.random.default_rng(8).normal(size=2)
    phase = 2 * np.pi * np.arange(N)[:, None] / 7.3
    expected = 1e-3 * (theta[0] * np.cos(phase) + theta[1] * np.sin(phase)) * force
    got = added("scale_cycle@7.3rows", theta, force, context)
    np.testing.assert_allclose(got, expected, atol=1e-12)
    dials = Context(40, {"record": np.arange(40.0), "tool_face": np.zeros(40)})
    one, other = families()["scale_cycle"], families()["cycle"]
    assert one.values(dials) == other.values(dials)
    assert one.nearby(dials, "8rows") == other.nearby(dials, "8rows")


def test_a_cycle_is_counted_in_seconds_where_rows_stand_at_an_uneven_pace() -> None:
    """With a clock at an uneven pace up to eight swings in ten rows: quick ones pass for no slow
    ones; at an even pace the rows say as much."""
    rng = np.random.default_rng(3)
    theta, force = rng.normal(size=6), rng.normal(size=(40, 3))
    time = np.cumsum(rng.uniform(60.0, 180.0, 40))
    known_here = {"record": np.arange(40.0), "tool_face": np.zeros(40), "time": time}
    phase = 2 * np.pi * time[:, None] / 222.0
    expected = 1e-3 * (theta[:3] * np.cos(phase) + theta[3:] * np.sin(phase))
    got = added("cycle@222s", theta, force, Context(40, known_here))
    np.testing.assert_allclose(got, expected, atol=1e-12)
    family = families()["cycle"]
    tried = [float(v.removesuffix("s")) for v in family.values(Context(40, known_here))]
    np.testing.assert_allclose(np.ptp(time) / np.array(tried), np.arange(1.5, 32.0, 0.5), rtol=1e-3)
    near = family.nearby(Context(40, known_here), "222s")
    assert min(abs(float(v.removesuffix("s")) - 222.0) for v in near) < 0.1
    even = known_here | {"time": 60.0 * np.arange(40.0)}
    assert all(v.endswith("rows") for v in family.values(Context(40, even)))


def test_a_step_in_time_is_tried_between_twelve_readings_and_twelve() -> None:
    """Forty readings a minute apart: from behind the 12th to before the 29th."""
    tried = families()["bias_step"].values(Context(40, {"time": 60.0 * np.arange(40)}))
    assert tried == tuple(f"{60 * k - 30}s" for k in range(12, 29))
    assert families()["bias_step"].values(Context(24, {"time": 60.0 * np.arange(24)})) == ()
    assert len(families()["bias_step"].values(Context(25, {"time": np.arange(25.0)}))) == 2


def test_the_neighbours_of_a_step_are_tried_after_it() -> None:
    """Of many times 48 are tried at first; those between the best and its neighbours come after."""
    context = Context(1000, {"time": 60.0 * np.arange(1000)})
    family = families()["bias_step"]
    first = [float(v[:-1]) for v in family.values(context)]
    assert len(first) == 48
    for k in (0, 20, 47):
        near = {float(v[:-1]) for v in family.nearby(context, f"{first[k]:.10g}s")}
        assert first[k] in near
        for other in first[max(0, k - 1) : k + 2]:
            between = np.arange(min(first[k], other), max(first[k], other) + 1.0, 60.0)
            assert near.issuperset(between)


def test_every_scan_shows_one_of_its_members_on_the_page() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for family in families().values():
        member = family.member(family.example)
        assert member.name == f"{family.name}@{family.example}"
        assert f"| `{member.name}`: `{member.equation}` | {family.sentence} |" in page
