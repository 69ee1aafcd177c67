"""Small inputs of the cases, made when the first case asks for one: "<bench.csv>" in a case.

Many are twins: the bench written otherwise (in rad, axes exchanged, a cell mistyped), which with
the option that says so must give what the bench gives.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from worlds.sheets import direction

Rows = NDArray[np.float64]
Make = Callable[[Path], None]
HEADING = "inclination,tool_face,x_mg,y_mg,z_mg"
G = 9.80665
#: Which recording of the cohort is of which device.
DEVICES = "recording,device\nworn1.h5,left\nworn2.h5,right\n"
#: K and b of the bench's sensor: reading = 1000 K f + b, mg.
GAIN = np.array([[1.006, 0.004, -0.006], [-0.003, 0.995, 0.002], [0.008, 0.001, 1.003]])
BIAS = np.array([12.0, -25.0, 31.0])


def rows() -> Rows:
    """(18, 5) the bench: inclination and tool-face in deg, x, y, z in mg; three rings of six."""
    k = np.arange(18)
    return _rows_at(np.array([-50.0, 10.0, 50.0])[k // 6], 60.0 * (k % 6) + 10.0 * (k // 6))


def _rows_at(i: Rows, t: Rows) -> Rows:
    rng = np.random.default_rng(5)
    ring = 0.05 * rng.standard_normal(len(i))[np.cumsum(np.diff(i, prepend=i[0]) != 0.0)]
    u = direction(i + ring, t + 0.05 * rng.standard_normal(len(i)))
    reading = 1000.0 * u @ GAIN.T + BIAS + 0.5 * rng.standard_normal((len(i), 3))
    return np.column_stack([i, t, np.round(reading, 4)])


def _aligned(path: Path) -> None:
    """24 rows in the paper's order: a meridian from +y to +z first, then rings."""
    ring = np.arange(30.0, 331.0, 50.0)
    i = np.concatenate([np.arange(0.0, 91.0, 10.0), np.full(7, 50.0), np.full(7, -40.0)])
    path.write_text(text_of(_rows_at(i, np.concatenate([np.zeros(10), ring, ring]))))


def text_of(table: Rows, heading: str = HEADING, mark: str = ",") -> str:
    lines = [mark.join(f"{v:.12g}" for v in row) for row in table]
    return "\n".join([heading.replace(",", mark), *lines]) + "\n"


def sheet(change: Callable[[Rows], Rows], heading: str = HEADING) -> Make:
    """A table: the bench after a change."""

    def made(path: Path) -> None:
        path.write_text(text_of(change(rows()), heading), encoding="utf-8")

    return made


def _angles(inclination: Callable[[Rows], Rows], tool_face: Callable[[Rows], Rows]) -> Make:
    return sheet(lambda r: np.column_stack([inclination(r[:, 0]), tool_face(r[:, 1]), r[:, 2:]]))


def _same(values: Rows) -> Rows:
    return values


def _cell(row: int, column: int, value: float) -> Make:
    def change(table: Rows) -> Rows:
        table[row - 1, column] = value
        return table

    return sheet(change)


def _order(order: list[int]) -> Make:
    """Readings of the rows in another order; angles stay."""
    return sheet(lambda r: np.column_stack([r[:, :2], r[order, 2:]]))


def _moved(at: int, to: int) -> list[int]:
    """Rows from 0 whose readings stand where they should not: --move AT,TO mends it."""
    order = list(range(18))
    order.insert(at - 1, order.pop(to - 1))
    return order


def _written(text: Callable[[Rows], str]) -> Make:
    return lambda path: path.write_text(text(rows()), encoding="utf-8") and None


def _faces(path: Path) -> None:
    """The bench by directions instead of angles."""
    table = rows()
    u = direction(table[:, 0], table[:, 1])
    path.write_text(text_of(np.column_stack([u, table[:, 2:]]), "ux,uy,uz,x_mg,y_mg,z_mg"))


def _other_device(heading: str, leave: int | None = None) -> Make:
    """A second device of the kind by norms: other bias, other noise; one row left out."""

    def change(table: Rows) -> Rows:
        noise = 0.5 * np.random.default_rng(9).standard_normal((18, 3))
        made = np.round(table[:, 2:] + np.array([-4.0, 7.0, 3.0]) + noise, 4)
        return made if leave is None else np.delete(made, leave, axis=0)

    return sheet(change, heading)


def _curved(path: Path) -> None:
    """48 norms with a ripple along x that has no name in the catalogue."""
    rng = np.random.default_rng(2)
    u = rng.standard_normal((60, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    bent = u + 0.012 * np.sin(7.0 * u[:, :1]) * np.array([1.0, 0.0, 0.0])
    reading = 1000.0 * bent @ GAIN.T + BIAS + 0.3 * rng.standard_normal((60, 3))
    path.write_text(text_of(reading, "x_mg,y_mg,z_mg"))


def _kind(bias: float, reference: str) -> Make:
    """A fleet that knows one number of its devices better than their readings can tell it."""
    return lambda path: path.write_text(
        f"schema: imucal/fleet\nversion: 1\ndevices: 9\nreference: {reference}\neffects: []\n"
        f"parameters: [{{name: bias_x, unit: mg, mean: {bias}, sd: 0.001}}]\n"
        "covariance: [[1.0e-06]]\nnoise: []\n",
        encoding="utf-8",
    )


def _lighter(table: Rows) -> Rows:
    """The bench where gravity is 9.75 m/s²: the sensor reads less of it, the unit stays."""
    lost = (1.0 - 9.75 / G) * 1000.0 * direction(table[:, 0], table[:, 1]) @ GAIN.T
    return np.column_stack([table[:, :2], table[:, 2:] - lost])


def _crossed(table: Rows) -> Rows:
    """z reads 30 mg of the product of x and y besides."""
    u = direction(table[:, 0], table[:, 1])
    return np.column_stack([table[:, :4], table[:, 4] + 30.0 * u[:, 0] * u[:, 1]])


def _jumped(table: Rows) -> Rows:
    """The tool turns by 2 deg in its clamp before row 10."""
    u = direction(table[9:, 0], table[9:, 1])
    moved = direction(table[9:, 0], table[9:, 1] + 2.0) - u
    return np.vstack([table[:9], np.column_stack([table[9:, :2], table[9:, 2:] + 1000.0 * moved])])


def _comma(table: Rows) -> str:
    """A table with ; between its columns and , in its numbers."""
    return text_of(table, mark=";").replace(".", ",")


def still(
    path: Path,
    *,
    seconds: tuple[float, ...] = (3.0,),
    rate: float = 50.0,
    table: Rows | None = None,
) -> None:
    """A recording that rests in every position of the bench, in m/s², and moves between.

    seconds : of the rests, in turn
    """
    rng = np.random.default_rng(8)
    means = (rows() if table is None else table)[:, 2:] * 1e-3 * G
    parts = []
    for k, mean in enumerate(means):
        held = int(seconds[k % len(seconds)] * rate)
        moved = mean + 3.0 * rng.standard_normal((int(1.5 * rate), 3))
        parts += [np.tile(mean, (held, 1)), moved]
    a = np.concatenate(parts)
    a += 0.01 * rng.standard_normal(a.shape)
    t = np.arange(len(a)) / rate
    temperature = 25.0 + 0.0 * t
    path.write_text(
        text_of(np.column_stack([t, a, temperature]), "t_s,ax_m/s2,ay_m/s2,az_m/s2,temperature_C")
    )


#: name -> how it is made; `inputs_recordings` holds those of the other commands.
TABLES: dict[str, Make] = {
    "bench.csv": sheet(_same),
    "aligned.csv": _aligned,
    "first12.csv": sheet(lambda r: r[:12]),
    "thrice.csv": sheet(lambda r: np.tile(r, (3, 1))),
    "without3and8.csv": sheet(lambda r: np.delete(r, [2, 7], axis=0)),
    "angles.csv": sheet(lambda r: r[:, :2], "inclination,tool_face"),
    "faces.csv": _faces,
    "lighter.csv": sheet(_lighter),
    "crossed.csv": sheet(_crossed),
    "norms.csv": sheet(lambda r: r[:, 2:], "x_mg,y_mg,z_mg"),
    "norms2.csv": _other_device("x_mg,y_mg,z_mg"),
    "norms_abc.csv": sheet(lambda r: r[:, 2:], "p,q,r"),
    "norms2_abc.csv": _other_device("p,q,r"),
    "norms_short.csv": sheet(lambda r: np.delete(r[:, 2:], 2, axis=0), "x_mg,y_mg,z_mg"),
    "norms2_short.csv": _other_device("x_mg,y_mg,z_mg", leave=2),
    "curved.csv": _curved,
    "kind.yaml": _kind(11.0, "vector"),
    "worn_kind.yaml": _kind(25.0, "norm"),
    "devices.csv": lambda path: path.write_text(DEVICES),
    "renamed.csv": sheet(_same, "alpha,beta,x_mg,y_mg,z_mg"),
    "upward.csv": _angles(np.negative, _same),
    "vertical.csv": _angles(lambda i: 90.0 - i, _same),
    "drilling.csv": _angles(lambda i: 90.0 - i, lambda t: t - 180.0),
    "from_x.csv": _angles(_same, lambda t: t - 90.0),
    "from_minus_x.csv": _angles(_same, lambda t: t + 90.0),
    "from_minus_y.csv": _angles(_same, lambda t: t + 180.0),
    "counter.csv": _angles(_same, np.negative),
    "turned7.csv": _angles(_same, lambda t: t - 7.0),
    "radians.csv": _angles(np.deg2rad, np.deg2rad),
    "swapped_angles.csv": sheet(lambda r: r[:, [1, 0, 2, 3, 4]]),
    "mistyped.csv": _cell(5, 3, 7000.0),
    "jumped.csv": sheet(_jumped),
    "slip.csv": _cell(5, 4, -float(rows()[4, 4])),
    "exchanged.csv": _order([0, 8, 2, 3, 4, 5, 6, 7, 1, *range(9, 18)]),
    "moved.csv": _order(_moved(3, 9)),
    "shifted.csv": _order([0, 2, 3, 4, 5, 1, *range(6, 18)]),
    "axes.csv": sheet(lambda r: np.column_stack([r[:, :2], r[:, 3], -r[:, 2], r[:, 4]])),
    "in_counts.csv": sheet(lambda r: np.column_stack([r[:, :2], r[:, 2:] * 4.096]),
                           "inclination,tool_face,x,y,z"),
    "titled.csv": _written(lambda r: "1,2,3,4,5\n6,7,8,9,10\n" + text_of(r)),
    "comma.csv": _written(_comma),
    "piped.csv": _written(lambda r: text_of(r, mark="^")),
    "rests.csv": still,
    "rests2.csv": still,
    "long_and_short.csv": lambda path: still(path, seconds=(2.0, 4.0)),
}  # fmt: skip
