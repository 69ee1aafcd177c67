"""Do stated intervals hold with few rows? Sheets of a generator that knows nothing of the program.

    python benchmarks/lab/few_rows.py [--sheets 60] [--seed 1]

A sensor with random bias, scale, axes and mounting is read in random attitudes, or on six faces,
that are set with errors and read with noise, both of sizes that differ from sheet to sheet. Told
are, per kind of sheet: how many components of corrected vectors at 40 random attitudes lie within
the stated 95 % interval, z rms with the covariance of the file, and the true error, mg rms.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from imucalib.calibration.uncertainty import correct_readings, force_slope
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import run_lab
from imucalib.errors import ImucalError

G, MG, DEG = 9.80665, 9.80665e-3, np.pi / 180.0
FACES = np.concatenate([np.eye(3), -np.eye(3)])
KINDS = {"6 rows": 6, "9 rows": 9, "12 rows": 12, "36 rows": 36, "six faces": 0, "twice": 0}


def rotation(rng: np.random.Generator, sd: float) -> np.ndarray:
    """(3, 3) a turn of about so many deg an axis, to second order and square."""
    x, y, z = sd * DEG * rng.normal(size=3)
    turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    u, _, v = np.linalg.svd(np.eye(3) + turn)
    return np.asarray(u @ v)


def sensor(rng: np.random.Generator, *, mounted: bool) -> tuple[np.ndarray, np.ndarray]:
    """S, c of reading = S force + c, m/s²."""
    gain = (
        np.eye(3) + np.diag(0.02 * rng.normal(size=3)) + np.tril(0.01 * rng.normal(size=(3, 3)), -1)
    )
    turn = rotation(rng, 1.5) if mounted else np.eye(3)
    return gain @ turn, 40.0 * MG * rng.normal(size=3)


def sizes(rng: np.random.Generator, usual: tuple[float, float]) -> tuple[float, float, float]:
    """Noise (m/s²) and scatter of both settings (rad) of a sheet. usual : mg and deg"""
    noise, *settings = np.exp(rng.normal(0.0, np.log(2.0), 3))
    return usual[0] * MG * noise, usual[1] * DEG * settings[0], usual[1] * DEG * settings[1]


def down(i: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(n, 3) paper 004's direction at inclination and tool-face, rad."""
    return np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=-1)


def sheet(
    kind: str, rng: np.random.Generator, usual: tuple[float, float]
) -> tuple[PositionTable, str, np.ndarray, np.ndarray]:
    """A table, the reference that reads it, and the sensor's S and c."""
    noise, first, second = sizes(rng, usual)
    gain, bias = sensor(rng, mounted=True)
    if KINDS[kind]:
        v = rng.normal(size=(KINDS[kind], 3))
        v /= np.linalg.norm(v, axis=1, keepdims=True)
        i, t = np.arcsin(v[:, 2]), np.arctan2(v[:, 0], v[:, 1])
        dial = {"inclination": np.round(i / DEG, 4), "tool_face": np.round(t / DEG, 4)}
        true = down(i + first * rng.normal(size=i.size), t + second * rng.normal(size=t.size))
    else:
        faces = np.tile(FACES, (2 if kind == "twice" else 1, 1))
        dial = {f"u{a}": faces[:, k] for k, a in enumerate("xyz")}
        tilt = first * rng.normal(size=faces.shape)
        true = faces + np.cross(tilt, faces)
        true /= np.linalg.norm(true, axis=1, keepdims=True)
    reading = G * true @ gain.T + bias + noise * rng.normal(size=true.shape)
    columns = {**dial, **{a: reading[:, k] / MG for k, a in enumerate("xyz")}}
    n = len(reading)
    table = PositionTable(
        columns, {c: c for c in columns}, dict.fromkeys("xyz", "mg"), np.arange(1, n + 1),
        path="sheet.csv", sha256="",
    )  # fmt: skip
    return table, "vector" if KINDS[kind] else "direction", gain, bias


def judged(
    kind: str, seed: int, *, loop: bool, usual: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Whether each component holds, its z and error (m/s²), and the exit code."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    table, reference, gain, bias = sheet(kind, rng, usual)
    request = LabRequest(reference=reference, gravity=G, loop=loop)
    run = run_lab(table, request)
    fit = run.result.final
    force = rng.normal(size=(40, 3))
    force *= G / np.linalg.norm(force, axis=1, keepdims=True)
    error = correct_readings(fit, force @ gain.T + bias) - force
    slope, _ = force_slope(fit, force)
    rows = slope.reshape(-1, slope.shape[-1])
    half = fit.half_width(rows).reshape(error.shape)
    sd = np.sqrt(np.einsum("np,pq,nq->n", rows, fit.covariance, rows)).reshape(error.shape)
    return np.abs(error) <= half, error / np.maximum(sd, 1e-30), error, run.outcome.exit_code


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--sheets", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--noise", type=float, default=1.0, help="usual noise, mg")
    parser.add_argument("--setting", type=float, default=0.3, help="usual setting error, deg")
    parser.add_argument("--loop", action="store_true", help="with the search")
    parser.add_argument("--kinds", default=",".join(KINDS))
    given = parser.parse_args()
    print("| sheet | hold, % | z rms | error, mg rms: median, 90 % | not judged | exit codes |")
    print("|---|---|---|---|---|---|")
    for kind in given.kinds.split(","):
        found, codes, refused = [], [], 0
        for k in range(given.sheets):
            try:
                usual = given.noise, given.setting
                *one, code = judged(kind, 1000 * given.seed + k, loop=given.loop, usual=usual)
            except ImucalError as error:
                refused += 1
                print(error, file=sys.stderr)
                continue
            found.append(one)
            codes.append(code)
        holds, z, error = (np.array([f[j] for f in found]) for j in range(3))
        each = np.sqrt(np.mean(error**2, axis=(1, 2))) / MG
        counts = ", ".join(f"{c}: {codes.count(c)}" for c in sorted(set(codes)))
        print(
            f"| {kind} | {100.0 * holds.mean():.1f} | {np.sqrt(np.mean(z**2)):.2f} | "
            f"{np.median(each):.2f}, {np.quantile(each, 0.9):.2f} | {refused} | {counts} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
