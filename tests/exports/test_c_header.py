"""The C header, compiled, against the calibration that it was made from."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.errors import UsageError
from imucalib.exports import export
from imucalib.recording.identity import Identity
from worlds.rigid_board import DEG, G, board
from worlds.rigid_board import calibration as board_calibration
from worlds.stated import stated

UG, COARSE = 1e-6, 1 / 2048

#: Traps every overflow, shift and conversion that C leaves undefined.
CC = ["cc", "-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-O1",
      "-fsanitize=undefined", "-fsanitize-undefined-trap-on-error"]  # fmt: skip
pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")

MAIN = """
#include <stdio.h>
#include "imucal_calibration.h"
int main(void) {
  double x[3];
  printf("%d\\n", SELF_TEST);
  while (scanf("%lf %lf %lf", x, x + 1, x + 2) == 3) {
    float f[3]; int32_t q[3]; int16_t s[3];
    for (int i = 0; i < 3; i++) {
      f[i] = (float)x[i]; q[i] = (int32_t)(x[i] * FINE); s[i] = (int16_t)(x[i] * COARSE);
    }
    APPLY(f); APPLY_FINE(q); APPLY_COARSE(s);
    for (int i = 0; i < 3; i++) printf("%.9g %ld %d ", f[i], (long)q[i], s[i]);
    printf("\\n");
  }
  return 0;
}
"""


def compiled(header: str, folder: Path, name: str = "", imu: int | None = None) -> Path:
    """A program that corrects lines of three numbers in float, 32 and 16 bits."""
    which = "" if imu is None else f"{imu}, "
    main = MAIN.replace("SELF_TEST", f"imucal_{name}self_test()")
    for call in ("APPLY_FINE", "APPLY_COARSE", "APPLY"):
        main = re.sub(rf"{call}\((\w)\)", rf"imucal_{name}{call.lower()}({which}\1, \1)", main)
    for scale in ("FINE", "COARSE"):
        main = main.replace(f"* {scale}", f"* IMUCAL_{name.upper()}{scale}")
    folder.mkdir(exist_ok=True)
    (folder / "imucal_calibration.h").write_text(header)
    (folder / "main.c").write_text(main)
    subprocess.run([*CC, "-o", "main", "main.c"], cwd=folder, check=True)
    return folder / "main"


def corrected(program: Path, reading: Array) -> tuple[int, Array, Array, Array]:
    """What the test of itself returns, and (n, 3) from float, 32 and 16 bits."""
    lines = "\n".join(" ".join(f"{v:.17g}" for v in row) for row in reading)
    done = subprocess.run([program], input=lines, capture_output=True, text=True, check=True)
    wrong, *rows = done.stdout.splitlines()
    value = np.array([row.split() for row in rows], dtype=float).reshape(-1, 3, 3)
    return int(wrong), value[:, :, 0], value[:, :, 1], value[:, :, 2]


VALUES = {
    "mounting": (0.6, -0.5, -2.0),
    "bias": (20.0, -15.0, 30.0),
    "scale": (0.01, -0.02, 0.005),
    "non_orthogonality": (0.002, -0.001, 0.003),
}


def one(values: dict[str, tuple[float, ...]] | None = None) -> Calibration:
    """An accelerometer whose parameters are correlated."""
    plain = stated(values or VALUES)
    size = {"deg": 0.05, "mg": 0.7, "1": 6e-4}
    sd = np.array([size[p.unit] for p in plain.parameters])
    root = np.random.default_rng(5).normal(size=(len(sd), len(sd)))
    correlation = root @ root.T
    scale = sd / np.sqrt(np.diag(correlation))
    covariance = correlation * np.outer(scale, scale)
    return stated(values or VALUES, covariance, raw_unit="ug", raw_to_si=1e-6 * G)


def some(count: int = 300, size: float = 1.5) -> Array:
    """Readings on whole counts of both fixed points, so that only the arithmetic rounds."""
    return np.asarray(
        np.rint(np.random.default_rng(1).normal(size=(count, 3)) * size * 2048) / 2048
    )


def test_all_three_arithmetics_correct_as_the_calibration_does(tmp_path: Path) -> None:
    made = one()
    program = compiled(export(made, "x.csv", "c-header").text, tmp_path)
    wrong, as_float, fine, coarse = corrected(program, some())
    due = made.apply(some() * G, unit="m/s2") / G
    assert wrong == 0
    assert as_float == pytest.approx(due, abs=2e-6)
    # Half a count of the offset, of the result, and for 32 bits of the reading cut to whole ug.
    assert np.abs(fine * UG - due).max() < 3 * UG
    assert np.abs(coarse * COARSE - due).max() < 1.2 * COARSE
    assert np.abs(coarse * COARSE - due).max() > 0.3 * COARSE


def test_fixed_point_ends_at_its_largest_number(tmp_path: Path) -> None:
    made = one({"bias": (500.0, -500.0, 0.0), "scale": (-0.02, -0.02, 0.01)})
    program = compiled(export(made, "x.csv", "c-header").text, tmp_path)
    reading = np.array([[-15.99, 15.99, 15.99]])
    _, _, fine, coarse = corrected(program, reading)
    due = made.apply(reading * G, unit="m/s2") / G
    assert due[0, 0] < -16.0 < 16.0 < due[0, 1]
    assert coarse[0].tolist()[:2] == [-32768, 32767]
    assert np.abs(fine * UG - due).max() < 3 * UG
    (tmp_path / "far.c").write_text(
        '#include <stdio.h>\n#include "imucal_calibration.h"\nint main(void) {\n'
        "  const int32_t far[3] = {INT32_MIN, INT32_MAX, 0};\n  int32_t out[3];\n"
        '  imucal_apply_fine(far, out);\n  printf("%ld %ld", (long)out[0], (long)out[1]);\n'
        "  return 0;\n}\n"
    )
    subprocess.run([*CC, "-o", "far", "far.c"], cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "far"], capture_output=True, text=True, check=True)
    assert done.stdout == "-2147483648 2147483647"


@pytest.mark.parametrize("table", ["M", "b_fine", "M_q14"])
def test_the_header_notices_a_changed_coefficient(table: str, tmp_path: Path) -> None:
    text = export(one(), "x.csv", "c-header").text
    start = text.index(f"imucal_{table}[3]")
    number = re.compile(r"-?\d[\d.]*(e[+-]\d+)?").search(text, text.index("{", start))
    assert number
    changed = float(number[0]) * 1.01 + (5 if "coarse" in table else 0)
    shown = f"{changed:.9e}" if "e" in number[0] else f"{changed:.0f}"
    broken = text[: number.start()] + shown + text[number.end() :]
    assert corrected(compiled(text, tmp_path / "well"), some(1))[0] == 0
    assert corrected(compiled(broken, tmp_path / "ill"), some(1))[0] > 0


@pytest.mark.slow
def test_every_imu_of_an_array_and_its_gyro(tmp_path: Path) -> None:
    made = board_calibration(board(np.random.default_rng(2), chips=3))
    text = export(made, "log.mcap", "c-header").text
    for imu, triad in enumerate(made.triads):
        wrong, as_float, fine, coarse = corrected(
            compiled(text, tmp_path / f"a{imu}", imu=imu), some()
        )
        due = triad.force(some() * G) / G
        assert wrong == 0
        assert as_float == pytest.approx(due, abs=3e-6)
        assert np.abs(fine * UG - due).max() < 3 * UG
        assert np.abs(coarse * COARSE - due).max() < 1.5 * COARSE
        reading = np.rint(some(size=200.0) * 10) / 10
        wrong, as_float, fine, coarse = corrected(
            compiled(text, tmp_path / f"g{imu}", "gyro_", imu), reading
        )
        due = triad.rate(reading * DEG) / DEG
        assert wrong == 0
        assert as_float == pytest.approx(due, abs=3e-4)
        assert np.abs(fine * 1e-5 - due).max() < 3e-5
        assert np.abs(coarse * 0.1 - due).max() < 0.25


def test_places_and_standard_deviations_of_an_array() -> None:
    drawn = board(np.random.default_rng(2), chips=3)
    plain = board_calibration(drawn)
    root = 1e-3 * np.random.default_rng(4).normal(size=(12, 12))
    made = replace(plain, triads=tuple(replace(t, covariance=root @ root.T) for t in plain.triads))
    text = export(made, "log.mcap", "c-header").text

    def numbers(name: str) -> Array:
        body = re.search(rf"imucal_{name}\[[^=]*= (.*);", text)
        assert body
        found = re.findall(r"-?\d+\.\d+e[+-]\d+", body[1])
        return np.array(found, dtype=float).reshape(-1, 3)

    assert numbers("r") == pytest.approx(drawn.places, abs=1e-8)
    rng, triad = np.random.default_rng(6), made.triads[1]
    way = rng.normal(size=(60, 3))
    way *= G / np.linalg.norm(way, axis=1, keepdims=True)
    reading = (way @ triad.gain.T + triad.bias) @ triad.rotation
    centre = np.concatenate([triad.gain.ravel(), triad.bias])
    seen = [
        replace(triad, gain=draw[:9].reshape(3, 3), bias=draw[9:]).force(reading)
        for draw in rng.multivariate_normal(centre, triad.covariance, size=2000)
    ]
    assert np.std(seen, axis=0).max(axis=0) / G == pytest.approx(numbers("sd")[1], rel=0.1)


@pytest.mark.parametrize(
    ("effect", "values"), [("scale", (-0.6, 0.0, 0.0)), ("bias", (0.0, 2e4, 0.0))]
)
def test_what_passes_fixed_point_is_refused(effect: str, values: tuple[float, ...]) -> None:
    with pytest.raises(UsageError, match="fixed point"):
        export(one({effect: values}), "x.csv", "c-header")


SEVERAL = """
#include <stdio.h>
#include "one.h"
#include "two.h"
#include "three.h"
#include "one.h"
int main(void) {
  const float raw[3] = {0.1f, -0.2f, 0.9f};
  float a[3], b[3], c[3];
  imucal_left_apply(raw, a);
  imucal_spare_apply(raw, b);
  imucal_aft_apply(raw, c);
  for (int i = 0; i < 3; i++) printf("%.9e %.9e %.9e ", (double)a[i], (double)b[i], (double)c[i]);
  printf("%d", imucal_left_self_test() + imucal_spare_self_test() + imucal_aft_self_test());
  return 0;
}
"""


def _renamed(made: Calibration, name: str) -> Calibration:
    return replace(made, sensor=Identity(name=name))


@pytest.mark.parametrize("compiler", ["gcc", "g++", "clang", "clang++"])
def test_headers_in_one_program_keep_their_numbers(compiler: str, tmp_path: Path) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}")
    one = stated({"bias": [10.0, 20.0, 30.0], "scale": [0.01, 0.02, 0.03]})
    two = stated({"bias": [-40.0, 5.0, 0.0], "scale": [-0.02, 0.0, 0.01]})
    three = stated({"bias": [0.0, 0.0, 7.0], "scale": [0.0, 0.04, 0.0]})
    every = {
        "one": _renamed(one, "left"),
        "two": _renamed(two, "spare"),
        "three": _renamed(three, "aft"),
    }
    for file, made in every.items():
        (tmp_path / f"{file}.h").write_text(export(made, "log", "c-header").text)
    source = tmp_path / ("main.cpp" if compiler.endswith("++") else "main.c")
    source.write_text(SEVERAL)
    warnings = ("-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wdouble-promotion", "-Werror")
    words = [compiler, *warnings, str(source), "-o", str(tmp_path / "main")]
    built = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (built.returncode, built.stderr) == (0, "")
    said = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True).stdout
    numbers = np.array(said.split(), float)
    assert numbers[-1] == 0
    reading = np.array([0.1, -0.2, 0.9])
    for k, made in enumerate(every.values()):
        due = made.apply(G * reading, unit="m/s2") / G
        np.testing.assert_allclose(numbers[k:9:3], due, atol=2e-6)


def test_two_calibrations_of_one_name_do_not_compile(tmp_path: Path) -> None:
    if shutil.which("gcc") is None:
        pytest.skip("no gcc")
    for file, bias in (("one", 10.0), ("two", 20.0)):
        made = stated({"bias": [bias] * 3, "scale": [0.0] * 3})
        (tmp_path / f"{file}.h").write_text(export(made, "log", "c-header").text)
    (tmp_path / "main.c").write_text(
        '#include "one.h"\n#include "two.h"\nint main(void) { return 0; }\n'
    )
    words = ["gcc", "-fsyntax-only", str(tmp_path / "main.c")]
    built = subprocess.run(words, capture_output=True, text=True, check=False)
    assert built.returncode != 0
    assert "--name" in built.stderr
