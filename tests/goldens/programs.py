"""Numbers of other programs on data that anybody can make again, each file with its certificate.

    pip install --target LIB statsmodels arviz-stats ahrs mpmath mcap mcap-ros2-support
    PYTHONPATH=LIB python tests/goldens/programs.py      writes tests/goldens/programs/*.csv

The tests read the files alone, and the sample logs. Data come from the generator of NIST SP 1065
(section 12.4), as in goldens/allantools: n <- 16807 n mod 2147483647, over 2147483647.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from datetime import date
from importlib.metadata import version
from math import fsum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FOLDER = Path(__file__).parent / "programs"
SAMPLES = Path(__file__).parents[2] / "sample_logs"


def uniform(count: int, seed: int = 1234567890) -> Array:
    """(count,) between 0 and 1."""
    out, n = np.empty(count), seed
    for k in range(count):
        out[k], n = n / 2147483647, 16807 * n % 2147483647
    return out


def normal(count: int, seed: int = 1234567890) -> Array:
    """(count,) of the normal distribution, by Box and Muller."""
    u = uniform(2 * count, seed).reshape(2, count)
    return np.sqrt(-2.0 * np.log(u[0])) * np.cos(2.0 * np.pi * u[1])


def crossed() -> tuple[Array, Array, Array, Array]:
    """72 numbers with four fixed effects and two crossed random ones: y, X (72, 4), and which of 8
    and of 9 levels each has."""
    k = np.arange(72)
    a, b = k % 8, k // 8
    x = np.column_stack([np.ones(72), normal(216, 99).reshape(72, 3)])
    y = x @ np.array([1.0, 0.5, -2.0, 0.3]) + 1.5 * normal(8, 7)[a] + 0.4 * normal(9, 8)[b]
    return y + normal(72, 9), x, a, b


def chains() -> Array:
    """(4, 250, 3): independent draws, an autoregression of 0.8, and chains that disagree."""
    e = normal(4 * 250 * 3, 5).reshape(4, 250, 3)
    out = e.copy()
    for k in range(1, 250):
        out[:, k, 1] = 0.8 * out[:, k - 1, 1] + 0.6 * e[:, k, 1]
    out[:, :, 2] += 0.4 * np.arange(4)[:, None]
    return out


def places() -> Array:
    """(20, 2) latitude in deg and height in m."""
    u = uniform(40, 3).reshape(20, 2)
    return np.column_stack([180.0 * u[:, 0] - 90.0, 5000.0 * u[:, 1]])


def forces() -> Array:
    """(20, 3) m/s²."""
    return 9.8 * normal(60, 4).reshape(20, 3)


def reml() -> tuple[str, str, Iterable[Array]]:
    import pandas
    import statsmodels.formula.api as smf

    y, x, a, b = crossed()
    data = pandas.DataFrame({"y": y, "x1": x[:, 1], "x2": x[:, 2], "x3": x[:, 3], "a": a, "b": b,
                             "one": 1})  # fmt: skip
    parts = {"a": "0 + C(a)", "b": "0 + C(b)"}
    model = smf.mixedlm("y ~ x1 + x2 + x3", data, groups="one", vc_formula=parts, re_formula="0")
    found = model.fit(reml=True, method="powell")
    found = model.fit(reml=True, method="lbfgs", start_params=found.params)
    row = np.array([found.scale, *found.vcomp])
    return "MixedLM.from_formula(vc_formula=...).fit(reml=True)", "s2,a2,b2", [row]


def diagnostics() -> tuple[str, str, Iterable[Array]]:
    from arviz_stats.base import array_stats

    draws, rows = chains(), []
    for k in range(3):
        x = draws[:, :, k]
        rows.append(np.array([
            array_stats.rhat(x, chain_axis=0, draw_axis=1, method="rank"),
            array_stats.ess(x, chain_axis=0, draw_axis=1, method="bulk"),
            array_stats.ess(x, chain_axis=0, draw_axis=1, method="tail", prob=(0.05, 0.95)),
            array_stats.mcse(x, chain_axis=0, draw_axis=1, method="mean"),
        ], dtype=float))  # fmt: skip
    return (
        "rhat(rank), ess(bulk), ess(tail, 0.05 and 0.95), mcse(mean)",
        "rhat,bulk,tail,mcse",
        rows,
    )


def gravity() -> tuple[str, str, Iterable[Array]]:
    from ahrs.utils import WGS

    wgs = WGS()
    rows = [np.array([lat, h, wgs.normal_gravity(lat, h)]) for lat, h in places()]
    return "WGS().normal_gravity(lat, h)", "latitude,height,gravity", rows


def angles() -> tuple[str, str, Iterable[Array]]:
    """Tilt has pitch = atan2(-ax, hypot(ay, az)) and roll = atan2(ay, az): inclination and
    tool-face of (x, y, z) where its axes are (-z, x, y)."""
    from ahrs.filters import Tilt

    f = forces()
    found = Tilt(np.column_stack([-f[:, 2], f[:, 0], f[:, 1]]), representation="angles").Q
    rows = list(np.asarray(found)[:, :2])
    return "Tilt(acc, representation='angles'), rad", "roll,pitch", rows


def _precise(found: object) -> float:
    return float(found)  # type: ignore[arg-type]


def student() -> tuple[str, str, Iterable[Array]]:
    """t with a probability of 0.975 below it, by the root of the regularised incomplete beta."""
    from mpmath import betainc, findroot, mp, mpf

    mp.dps = 40
    rows = []
    for dof in (1, 2, 3, 5, 9, 15, 27, 60, 399):

        def off(t: object, dof: int = dof) -> object:
            return betainc(mpf(dof) / 2, mpf(1) / 2, 0, dof / (dof + t * t), regularized=True) - (
                mpf(1) / 20)  # fmt: skip

        rows.append(np.array([dof, _precise(findroot(off, (1.9, 13.0), solver="anderson"))]))
    return "findroot of betainc(dof/2, 1/2, 0, dof/(dof+t²)) = 0.05, 40 digits", "dof,t", rows


def chi_square() -> tuple[str, str, Iterable[Array]]:
    """Upper tails; degrees of freedom need not be whole."""
    from mpmath import gammainc, mp, mpf

    mp.dps = 40
    rows = [
        np.array([dof, x, _precise(gammainc(mpf(dof) / 2, mpf(x) / 2, regularized=True))])
        for dof in (1.0, 2.0, 3.5, 11.25, 50.0, 400.0)
        for x in (0.25 * dof, dof, 1.5 * dof, 2.0 * dof + 10.0, 4.0 * dof + 40.0)
    ]
    return "gammainc(dof/2, x/2, regularized=True), 40 digits", "dof,x,tail", rows


def chi_quantiles() -> tuple[str, str, Iterable[Array]]:
    """Values with 0.025 and 0.975 above them."""
    from mpmath import findroot, gammainc, mp, mpf

    mp.dps = 40
    rows = []
    for dof in (2, 3, 6, 11):
        ends = []
        for tail in (mpf("0.025"), mpf("0.975")):

            def off(x: object, dof: int = dof, tail: object = tail) -> object:
                return gammainc(mpf(dof) / 2, x / 2, regularized=True) - tail

            ends.append(_precise(findroot(off, (0.01, 60.0), solver="anderson", maxsteps=500)))
        rows.append(np.array([dof, *ends]))
    return "findroot of gammainc(dof/2, x/2) = 0.025 and 0.975, 40 digits", "dof,high,low", rows


#: Recordings of the sample logs that hold ROS messages.
LOGS = ("rests.mcap", "board_part.mcap")
SUMS = ("first", "last", "messages", *(f"{kind}_{axis}" for kind in
        ("force", "rate", "force_turn", "rate_turn") for axis in "xyz"))  # fmt: skip


def summary(stamp: Array, force: Array, rate: Array) -> Array:
    """What one topic holds in numbers that a lost, doubled, moved or exchanged sample changes.

    stamp : (n,) s after the log's first stamp; force, rate : (n, 3); exact sums, then those by turn
    """
    turn = np.arange(1.0, len(stamp) + 1.0)[:, None] / len(stamp)
    each = np.concatenate([force, rate, force * turn, rate * turn], axis=1)
    return np.array([stamp[0], stamp[-1], len(stamp), *(fsum(column) for column in each.T)])


def messages() -> tuple[str, str, Iterable[Array]]:
    """Every topic of the sample logs in order of its name, by the official decoders."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    rows = []
    for number, name in enumerate(LOGS):
        topics: dict[str, list[tuple[int, ...]]] = {}
        with (SAMPLES / name).open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
                if not hasattr(message, "linear_acceleration"):
                    continue
                at, a, w = (message.header.stamp, message.linear_acceleration,
                            message.angular_velocity)  # fmt: skip
                one = (at.sec * 10**9 + at.nanosec, a.x, a.y, a.z, w.x, w.y, w.z)
                topics.setdefault(channel.topic, []).append(one)
        start = min(found[0][0] for found in topics.values())
        for topic in sorted(topics):
            stamp = np.array([1e-9 * (one[0] - start) for one in topics[topic]])
            value = np.array([one[1:] for one in topics[topic]], np.float64)
            rows.append(np.array([number, *summary(stamp, value[:, :3], value[:, 3:])]))
    return (
        f"make_reader with mcap-ros2-support {version('mcap-ros2-support')}, of {', '.join(LOGS)}",
        ",".join(("log", *SUMS)),
        rows,
    )


MADE: dict[str, tuple[str, Callable[[], tuple[str, str, Iterable[Array]]]]] = {
    "reml": ("statsmodels", reml),
    "diagnostics": ("arviz-stats", diagnostics),
    "gravity": ("ahrs", gravity),
    "angles": ("ahrs", angles),
    "student": ("mpmath", student),
    "chi_square": ("mpmath", chi_square),
    "chi_quantiles": ("mpmath", chi_quantiles),
    "messages": ("mcap", messages),
}


def main(names: list[str]) -> None:
    """Write the files that are asked for, all where none is."""
    FOLDER.mkdir(exist_ok=True)
    for name in names or list(MADE):
        package, made = MADE[name]
        command, heading, rows = made()
        first = f"# {date.today()}, {package} {version(package)}, numpy {np.__version__}: {command}"
        lines = [first, heading, *(",".join(repr(float(v)) for v in row) for row in rows)]
        (FOLDER / f"{name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
