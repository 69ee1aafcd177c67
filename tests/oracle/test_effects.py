"""Every effect of the catalogue against its printed equation, computed without the code."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib.core.effect import Context, Effect, Motion, Truth
from imucalib.effects import catalogue
from imucalib.units import DEG, STANDARD_GRAVITY
from oracle.by_hand import BY_HAND, direction
from oracle.equations import Entry, evaluated, page, size_of

PAGE = page()
N, SWEEPS = 40, 3


def world(seed: int) -> tuple[dict[str, np.ndarray], Truth, Context]:
    """Known quantities by the page's names, and the same as the code takes them."""
    rng = np.random.default_rng(seed)
    i, t = rng.uniform(-80, 80, N), rng.uniform(0, 360, N)
    known = {
        "a": rng.normal(size=(N, 3)), "ω": 300.0 * rng.normal(size=(N, 3)),
        "spin": 50.0 * rng.normal(size=(N, 3)), "jerk": 30.0 * rng.normal(size=(N, 3)),
        "previous": rng.normal(size=(N, 3)), "T": rng.uniform(10, 40, N),
        "order": np.sort(rng.uniform(0, 1, N)), "i": i, "t": t, "age": rng.uniform(-0.5, 0.5, N),
        "approach": rng.choice([-1.0, 1.0], N), "sweep": np.sort(rng.integers(0, SWEEPS, N)),
        "day": rng.uniform(0, 1, N), "side": rng.choice([-1.0, 0.0, 1.0], (N, 3)),
    }  # fmt: skip
    known["later"] = (known["sweep"] > 0).astype(float)
    known["φ"] = 360.0 * known["day"]
    g = STANDARD_GRAVITY
    covariates = {
        "temperature": known["T"], "order": known["order"], "time": 3600.0 * known["order"],
        "inclination": DEG * i, "tool_face": DEG * t, "sweep": known["sweep"].astype(float),
        "inclination_approach": known["approach"], "tool_face_approach": known["approach"],
        "time_of_day": 2.0 * np.pi * known["day"], "sample_age": known["age"][:, None],
        **{f"previous_{x}": g * known["previous"][:, k] for k, x in enumerate("xyz")},
        **{f"approach_{x}": known["side"][:, k] for k, x in enumerate("xyz")},
    }  # fmt: skip
    motion = Motion(DEG * known["ω"][:, None], known["spin"][:, None], known["jerk"][:, None])
    context = Context(N, covariates, sweeps=SWEEPS, moving=True)
    return known, Truth(g * known["a"][:, None], motion), context


def entry_of(name: str) -> Entry:
    assert name in PAGE, f"{name} has no entry in docs/effects.md: python docs/generate.py"
    return PAGE[name]


def expected(effect: Effect, theta: np.ndarray, known: dict[str, np.ndarray]) -> np.ndarray:
    """What the page says comes out: (n, 3), in g or deg/s."""
    entry = entry_of(effect.name)
    if effect.name in BY_HAND:
        text, formula = BY_HAND[effect.name]
        assert entry.equation == text, "the page has another equation than the one below"
        units = [size_of(u) for u in entry.parameters.values()]
        return formula(theta * (np.array(units) if len(units) == len(theta) else 1.0), known)
    dials = {n: known[n] for n in ("i", "t", "approach")}
    if effect.stage == "fixture":
        angle = evaluated(entry, theta, dials)
        if entry.equation.startswith("i ="):
            return direction(angle, known["t"])
        return direction(known["i"], angle)
    names = ("a", "ω", "T", "order", "previous", "side", "later", "φ")
    return evaluated(entry, theta, {n: known[n] for n in names} | {"x": known["a"]})


@pytest.mark.parametrize("name", sorted(catalogue()))
@pytest.mark.parametrize("seed", [0, 1])
def test_the_code_does_what_the_page_prints(name: str, seed: int) -> None:
    effect = catalogue()[name]
    known, truth, context = world(seed)
    parameters = effect.parameters(context)
    rng = np.random.default_rng(seed + 10)
    theta = np.array([3.0 * p.typical for p in parameters]) * rng.normal(size=len(parameters))
    if effect.stage == "fixture":
        truth = Truth(STANDARD_GRAVITY * direction(known["i"], known["t"])[:, None])
        known["x"] = direction(known["i"], known["t"])
    else:
        known["x"] = known["a"]
    start = truth.turning.rate if effect.channel == "angular_rate" else truth.force
    unit = DEG if effect.channel == "angular_rate" else STANDARD_GRAVITY
    got = (start + effect.act(theta, truth, context).delta)[:, 0] / unit
    np.testing.assert_allclose(got, expected(effect, theta, known), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", sorted(set(catalogue()) - {"tool_face_zero_per_sweep"}))
def test_sizes_and_names_are_those_of_the_page(name: str) -> None:
    parameters = catalogue()[name].parameters(world(0)[2])
    assert tuple(p.name for p in parameters) == tuple(entry_of(name).parameters)
    assert tuple(p.unit for p in parameters) == tuple(PAGE[name].parameters.values())
    np.testing.assert_allclose([p.typical for p in parameters], PAGE[name].typical)
    np.testing.assert_allclose([p.plausible for p in parameters], PAGE[name].most)


def test_a_changed_word_or_number_is_noticed() -> None:
    """The parser reads the page: another equation gives another reading."""
    known, *_ = world(0)
    entry = PAGE["quadratic"]
    assert not np.allclose(
        evaluated(entry, np.full(3, 5.0), {"x": known["a"]}),
        evaluated(type(entry)(entry.name, entry.equation.replace("²", "³"), entry.parameters),
                  np.full(3, 5.0), {"x": known["a"]}),
    )  # fmt: skip
