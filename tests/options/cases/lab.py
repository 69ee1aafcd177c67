"""Cases of `imucal lab`: a table is repaired, read, fitted and judged as the option says."""

from __future__ import annotations

import numpy as np

from options.bench import Bench
from options.case import USUAL, Case, Of, as_its_kind, ends, gives_what, numbers_of, values
from options.inputs import BIAS, GAIN, G, rows
from options.outcome import Outcome

LAB = Of("lab")
PLAIN = USUAL["lab"]
LOOP = ("--only", "cubic", "--json")
NUMBERS = ("parameters", "covariance", "matrices", "loop", "noise")


def _on(name: str, *more: str) -> tuple[str, ...]:
    return ("lab", f"<{name}>", "--no-loop", "--json", *more)


def _repairs(given: str, name: str, *more: str) -> Case:
    """A damaged twin, mended: what the sound bench gives."""
    return LAB(given, gives_what(*_on("bench.csv", *more)), *_on(name, *more))


def _means(given: str, name: str) -> Case:
    """Angles written otherwise: the same numbers; shown angles follow the convention."""
    return LAB(given, numbers_of(*PLAIN, keys=NUMBERS), *_on(name))


def _gain(done: Outcome) -> tuple[np.ndarray, np.ndarray]:
    """K and b (mg) of reading = K f + b, from the correction that is printed."""
    found = done.content["matrices"]["corrected_from_raw"]
    m, b = np.array(found["M"]), np.array(found["b"])
    return np.linalg.inv(m), -np.linalg.solve(m, b) / G * 1000.0


def _plain_least_squares(without: Outcome, done: Outcome, bench: Bench) -> None:
    """--objective vector: angles are exact, so K and b are a linear least-squares fit."""
    table = rows()
    i, t = np.deg2rad(table[:, 0]), np.deg2rad(table[:, 1])
    f = np.column_stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i), np.ones(18)])
    found = np.linalg.lstsq(f, table[:, 2:], rcond=None)[0]
    gain, bias = _gain(done)
    np.testing.assert_allclose(1000.0 * gain.T, found[:3], atol=1e-3)
    np.testing.assert_allclose(bias, found[3], atol=1e-3)


def _another_fit_of_the_same(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Rows weigh otherwise, and the sensor is the same: half a mg of noise and 0.05 deg."""
    assert done.code == 0, done.stderr
    gain, bias = _gain(done)
    np.testing.assert_allclose(gain, GAIN, atol=3e-3)
    np.testing.assert_allclose(bias, BIAS, atol=2.5)


def _nine(without: Outcome, done: Outcome, bench: Bench) -> None:
    names = [n for n in values(without) if not n.startswith("mounting")]
    assert list(values(done)) == names
    assert len(names) == 9


def _first_twelve(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Fitted on rows 1-12 alone, and judged on the six that it never saw."""
    numbers_of(*_on("first12.csv"), keys=("parameters", "covariance"))(without, done, bench)
    fitted = [p["fitted"] for p in done.content["positions"]]
    assert fitted == [True] * 12 + [False] * 6
    assert {s["positions"] for s in done.content["held_out"] if "test" in s["split"]} == {6}


def _without_rows(without: Outcome, done: Outcome, bench: Bench) -> None:
    numbers_of(*_on("without3and8.csv"), keys=("parameters", "covariance", "noise"))(
        without, done, bench
    )
    names = [p["position"] for p in done.content["positions"]]
    assert names == [f"row {k}" for k in range(1, 19) if k not in (3, 8)]
    assert [text.split(":")[0] for text in done.content["left_out"]] == ["row 3", "row 8"]


def _of_recording(without: Outcome, done: Outcome, bench: Bench) -> None:
    """Readings are those of the rests: what the table says, within their noise."""
    assert done.code == 0, done.stderr
    gain, bias = _gain(done)
    np.testing.assert_allclose(gain, GAIN, atol=2e-3)
    np.testing.assert_allclose(bias, BIAS, atol=1.5)
    assert len(done.content["positions"]) == 18


def _by_directions(without: Outcome, done: Outcome, bench: Bench) -> None:
    gain, bias = _gain(done)
    np.testing.assert_allclose(gain, GAIN, atol=2e-3)
    np.testing.assert_allclose(bias, BIAS, atol=1.5)
    assert "tool_face_setting_deg" not in done.content["noise"]


def _slip_left_out(without: Outcome, done: Outcome, bench: Bench) -> None:
    assert (without.code, done.content["undecided"]) == (5, [])
    assert [text.split(":")[0] for text in done.content["left_out"]] == ["row 5"]
    other = bench.run(("lab", "<bench.csv>", *LOOP, "--exclude", "5"))
    for name, value in values(other).items():
        assert np.isclose(values(done)[name], value, atol=1e-4), name


def _declared_noise(without: Outcome, done: Outcome, bench: Bench) -> None:
    error = done.content["loop"]["errors"][0]
    assert without.content["loop"]["errors"][0]["floor"] is None
    assert error["floor"] == 3.0 if "vector" not in error["metric"] else error["floor"] > 3.0


def _straightened(without: Outcome, done: Outcome, bench: Bench) -> None:
    """--keep-angles goes on with angles that look exchanged."""
    assert without.code == 2
    assert "--swap-angles" in without.stderr
    assert done.code != 2


def _part_that_stands(without: Outcome, done: Outcome, bench: Bench) -> None:
    """The mounting is that of the rows that are trusted, 2 deg from that of the others."""
    assert (without.code, done.content["undecided"]) == (5, [])
    assert "--trust 10-18" in " ".join(without.content["undecided"])
    other = bench.run(("lab", "<jumped.csv>", *_SLIPS, "--trust", "1-9"))
    turns = [[values(one)[f"mounting_{a}"] for a in "xyz"] for one in (done, other)]
    assert np.isclose(np.linalg.norm(np.subtract(*turns)), 2.0, atol=0.1)


_SLIPS = ("--only", "slip", "--json")
CASES: tuple[Case, ...] = (
    LAB("--recording <rests.csv>", _of_recording, *_on("angles.csv")),
    LAB("--reference direction", _by_directions, *_on("faces.csv")),
    LAB("--reference norm", _nine),
    LAB("--fleet <kind.yaml>", as_its_kind(11.0)),
    _repairs("--columns inclination=alpha,tool_face=beta", "renamed.csv"),
    _means("--convention drilling-gravity", "drilling.csv"),
    _means("--gravity-sign up", "upward.csv"),
    _means("--z-axis up-hole", "upward.csv"),
    _means("--inclination-zero vertical", "vertical.csv"),
    _means("--toolface-zero-axis +x", "from_x.csv"),
    _means("--toolface-zero-axis -x", "from_minus_x.csv"),
    _means("--toolface-zero-axis -y", "from_minus_y.csv"),
    _means("--toolface-sense counter-clockwise", "counter.csv"),
    _means("--toolface-offset 7", "turned7.csv"),
    LAB("--model geometric9", _nine),
    LAB("--objective vector", _plain_least_squares),
    LAB("--objective angles", _another_fit_of_the_same),
    LAB("--objective paper", _another_fit_of_the_same, *_on("aligned.csv")),
    LAB(
        "--as-published",
        numbers_of(
            *_on(
                "aligned.csv",
                "--model",
                "linear12",
                "--objective",
                "paper",
                "--train",
                "1-20",
                "--gravity",
                "9.8061",
            ),
            keys=("parameters", "covariance", "matrices", "held_out"),
        ),
        *_on("aligned.csv"),
    ),
    LAB("--train 1-12", _first_twelve),
    LAB("--trust 10-18", _part_that_stands, "lab", "<jumped.csv>", *_SLIPS),
    LAB("--exclude 3,8", _without_rows),
    _repairs(f"--fix 5:y={rows()[4, 3]:.10g}", "mistyped.csv"),
    _repairs("--swap 2,9", "exchanged.csv"),
    _repairs("--move 3,9", "moved.csv"),
    LAB(
        "--shift readings:2-6=1",
        numbers_of(*_on("bench.csv", "--exclude", "2"), keys=("parameters", "covariance", "noise")),
        *_on("shifted.csv"),
    ),
    _repairs("--axes=-y,x,z", "axes.csv"),
    _repairs("--angle-unit rad", "radians.csv"),
    LAB("--auto-exclude", _slip_left_out, "lab", "<slip.csv>", *LOOP),
    _repairs("--swap-angles", "swapped_angles.csv"),
    LAB("--keep-angles", _straightened, *_on("swapped_angles.csv")),
    LAB(
        "--shortest-rest 4",
        ends(3, "18 too short"),
        *_on("angles.csv", "--recording", "<rests.csv>"),
    ),
    LAB("--sigma 3", _declared_noise),
    LAB("--unit g", ends(3, "1008 g with unit g, as given")),
    LAB("--lsb 4096", gives_what(*PLAIN), *_on("in_counts.csv", "--unit", "counts")),
    _repairs("--skip 2", "titled.csv"),
    LAB("--decimal .", ends(3), *_on("comma.csv")),
    _repairs("--delimiter ^", "piped.csv"),
)
