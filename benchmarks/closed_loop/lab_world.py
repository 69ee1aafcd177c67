"""Benches for the acceptance benchmark: 32 positions, 0.3 mg, settings good to 0.02 degrees."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from trial import Job, Trial, coverage, noise, said, strengths, vector_error

from imucalib.calibration.uncertainty import correcting
from imucalib.calibrators.lab.bench import position_observations
from imucalib.calibrators.lab.calibrate import MODELS, LabSettings
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.design import recommend
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import run_lab
from imucalib.core.context import Context
from imucalib.core.model import Model
from imucalib.effects import catalogue, named
from imucalib.errors import ImucalError
from imucalib.loop.found import LoopSettings
from imucalib.units import DEG, MG, STANDARD_GRAVITY

Array = NDArray[np.float64]

N = 32
SIGMA = 0.3  # mg
SETTING = {"": (0.02, 0.03), "scatter": (0.2, 0.3)}  # deg
SENSOR = {
    "mounting": (0.4, -0.7, 1.1),
    "bias": (25.0, -18.0, 32.0),
    "scale": (0.006, -0.004, 0.009),
    "non_orthogonality": (0.003, -0.002, 0.004),
}
OUTSIDE = {
    "third_harmonic": "tool-face",
    "local_sine": "xyz",
    "step_in_order": "order",
    "thermal_lag": "temperature order",
    "random_walk": "order",
    "soft_saturation": "xyz",
}
NOISE = ("t4", "ar", "scatter")
CONFOUNDED = (
    ("temperature_bias", "monotone", 0.1),
    ("bias_drift", "monotone", 1.0),
    ("warm_up", "monotone", 1.0),
)
FAULTS = ("swapped columns", "swapped labels", "lost sign", "factor ten", "radians")


def effects() -> tuple[str, ...]:
    """Effects that a random-order bench can carry and does not absorb."""
    data = position_observations(
        _blank(np.random.default_rng(0), ""), np.zeros((N, 3)), Conventions(), STANDARD_GRAVITY
    )
    every = catalogue().values()
    silent = {"tool_face_zero", *SENSOR}
    return tuple(e.name for e in every if e.name not in silent and not e.missing(data.context))


def trial(job: Job) -> Trial:
    """Simulate a bench, run the whole command on its table, and judge."""
    rng = np.random.default_rng(job.seed)
    bench = _Bench(job, rng)
    table = bench.table(rng)
    settings = LabSettings(sigma=SIGMA * MG, rules=LoopSettings(curves=job.outside is not None))
    request = LabRequest(unit="mg", settings=settings, seed=job.seed)
    started = time.process_time()
    try:
        run = run_lab(table, request)
    except ImucalError as error:
        return Trial(job, refused=str(error), seconds=time.process_time() - started)
    seconds = time.process_time() - started
    result = run.result
    if job.fault and result.loop is None:  # a slip of hand, told before any search
        return Trial(job, refused="; ".join(run.outcome.undecided), seconds=seconds)
    assert result.loop is not None
    if job.fault:
        return said(Trial(job, seconds=seconds), result.loop)
    known = replace(settings, declare=tuple(bench.planted), loop=False)
    oracle = run_lab(table, replace(request, settings=known)).result.final
    reading, force, context = bench.test(rng)
    truth = {name: np.array(v) for name, v in SENSOR.items()}
    covered, intervals = coverage(result.final, truth)
    found = Trial(
        job,
        strength=strengths(oracle, bench.planted),
        before=vector_error(result.base, reading, force, context),
        after=vector_error(result.final, reading, force, context),
        oracle=vector_error(oracle, reading, force, context),
        covered=covered,
        intervals=intervals,
        seconds=seconds,
    )
    return said(found, result.loop)


class _Bench:
    """A bench with all that was planted in it."""

    def __init__(self, job: Job, rng: np.random.Generator) -> None:
        self.job, self.gravity = job, STANDARD_GRAVITY
        self.blank = _blank(rng, job.layout)
        nominal = np.stack([self.blank.columns[a] for a in "xyz"], axis=-1) * MG
        self.data = position_observations(self.blank, nominal, Conventions(), self.gravity)
        self.planted: dict[str, Array] = {}
        for name, size in job.effects:
            typical = [p.typical for p in named(name).parameters(self.data.context)]
            self.planted[name] = size * np.array(typical) * rng.standard_normal(len(typical))
        names = (*MODELS["linear12"], *self.planted)
        self.model = Model(tuple(named(n) for n in names))
        self.theta = self._theta(self.model, self.data.context)
        self.phase = rng.uniform(0.0, 2.0 * np.pi, 3)
        self.at = int(rng.integers(6, N - 6))
        self.walk = np.cumsum(rng.standard_normal((N, 3)), axis=0) / np.sqrt(N)

    def _theta(self, model: Model, context: Context) -> Array:
        theta, slices = model.start(context), model.slices(context)
        for name, values in {**SENSOR, **self.planted}.items():
            if name in slices:
                theta[slices[name]] = values
        return theta

    def table(self, rng: np.random.Generator) -> PositionTable:
        """The table as the technician would save it, in mg, faults included."""
        data, job = self.data, self.job
        reference = data.reference
        scatter = SETTING.get(job.noise, SETTING[""])
        eta = np.concatenate(
            [
                sd * DEG * rng.standard_normal(int(ids.max()) + 1)
                for sd, ids in zip(
                    scatter, (reference.inclination_setting, reference.tool_face_setting),
                    strict=True,
                )
            ]
        )  # fmt: skip
        if job.outside and job.outside[0] == "third_harmonic":
            wave = 0.1 * DEG * np.sin(3.0 * reference.tool_face + self.phase[0])
            ids = reference.tool_face_setting + int(reference.inclination_setting.max()) + 1
            eta[ids] += job.outside[1] * wave
        truth = reference.truth(eta)
        reading = self.model.predict(self.theta, truth, data.context).reading[:, 0]
        reading = reading + self._outside(truth[:, 0], np.arange(N))
        reading = reading / MG + SIGMA * noise(job.noise, (N, 3), rng)
        columns = {**self.blank.columns, **{a: reading[:, k] for k, a in enumerate("xyz")}}
        return replace(self.blank, columns=_faulty(columns, job.fault, rng))

    def _outside(self, force: Array, rows: Array) -> Array:
        """What no catalogue effect does, (n, 3) m/s², at forces and with the covariates of rows."""
        name, size = self.job.outside or ("nothing", 0.0)
        g = force / self.gravity
        steep = np.sign(g) * np.maximum(np.abs(g) - 0.8, 0.0) ** 2
        late = np.zeros(N)
        warm = self.blank.columns["temperature"] - 25.0
        for k in range(1, N):
            late[k] = late[k - 1] + 0.3 * (warm[k] - late[k - 1])
        shapes = {
            "local_sine": np.sin(2.0 * np.pi * g / 0.35 + self.phase),
            "soft_saturation": -40.0 * steep,
            "step_in_order": 2.0 * (rows >= self.at)[:, None] * np.sin(self.phase),
            "random_walk": 3.0 * self.walk[rows],
            "thermal_lag": 0.2 * late[rows, None] * np.sin(self.phase),
        }
        return np.asarray(size * MG * shapes.get(name, np.zeros_like(g)))

    def test(self, rng: np.random.Generator) -> tuple[Array, Array, Context]:
        """Noise-free readings of the sensor at directions and conditions that it may meet."""
        n = 300
        direction = rng.standard_normal((n, 3))
        force = self.gravity * direction / np.linalg.norm(direction, axis=1, keepdims=True)
        rows = rng.integers(0, N, n)
        if self.job.outside and self.job.outside[0] in ("step_in_order", "random_walk"):
            rows = np.full(n, N - 1)  # the sensor as it is now
        context = self.data.context.take(rows)
        model = correcting(self.model)
        reading = model.predict(self._theta(model, context), force[:, None], context).reading[:, 0]
        return reading + self._outside(force, rows), force, context


def _blank(rng: np.random.Generator, layout: str) -> PositionTable:
    """Angles, temperature, approach and nominal readings, in random order unless a layout says
    otherwise: "monotone" warms up along a set order and always approaches from below."""
    inclination, tool_face = (np.round(a / DEG, 6) for a in recommend(N))
    order = rng.permutation(N)
    warm = np.where(rng.random(N) < 0.5, 12.0, 38.0) + rng.uniform(-2.0, 2.0, N)
    columns = {
        "inclination": inclination[order],
        "tool_face": tool_face[order],
        "temperature": warm,
        "inclination_approach": np.where(rng.random(N) < 0.5, -1.0, 1.0),
        "tool_face_approach": np.where(rng.random(N) < 0.5, -1.0, 1.0),
    }
    if layout == "monotone":
        columns |= {"inclination": inclination, "tool_face": tool_face}
        columns["temperature"] = np.linspace(15.0, 35.0, N) + rng.uniform(-0.5, 0.5, N)
    meant = STANDARD_GRAVITY * _directions(columns["inclination"], columns["tool_face"])
    columns |= {a: meant[:, k] / MG for k, a in enumerate("xyz")}
    return PositionTable(columns, {r: r for r in columns}, {}, np.arange(1, N + 1), "bench", "")


def _directions(inclination: Array, tool_face: Array) -> Array:
    from imucalib.core.references import unit_vector

    return unit_vector(*Conventions().inside(inclination, tool_face))


def _faulty(columns: dict[str, Array], fault: str, rng: np.random.Generator) -> dict[str, Array]:
    columns = {name: values.copy() for name, values in columns.items()}
    row = int(rng.integers(0, N))
    axis = "xyz"[int(np.argmax([abs(columns[a][row]) for a in "xyz"]))]
    if fault == "swapped columns":
        i, t = columns["inclination"], columns["tool_face"]
        columns |= {"inclination": t, "tool_face": i}
    elif fault == "swapped labels":
        far = [
            k
            for k in range(N)
            if abs(columns["tool_face"][k] - columns["tool_face"][row]) > 20
            and abs(columns["inclination"][k]) < 80
            and abs(columns["inclination"][row]) < 80
        ]
        other = int(rng.choice(far)) if far else (row + 1) % N
        for role in ("inclination", "tool_face"):
            columns[role][[row, other]] = columns[role][[other, row]]
    elif fault == "lost sign":
        columns[axis][row] *= -1.0
    elif fault == "factor ten":
        columns[axis][row] *= 10.0
    elif fault == "radians":
        columns["tool_face"] = columns["tool_face"] * DEG
        columns["inclination"] = columns["inclination"] * DEG
    return columns
