"""What a fleet says of the next device: the file, the prior, and `imucal lab --fleet`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.population import Population, PriorNoise, PriorParameter, read, to_yaml
from imucalib.errors import UnreadableInput
from options.outcome import Outcome, run
from worlds.bench import base_model, tumble

KIND = Population(
    devices=7,
    reference="norm",
    effects=("quadratic",),
    parameters=(
        PriorParameter("bias_x", "mg", 3.0, 2.0),
        PriorParameter("scale_y", "1", 0.01, 0.002),
    ),
    covariance=np.array([[4.0, 0.001], [0.001, 4e-6]]),
    noise=(PriorNoise("reading", 0.02, 0.3),),
)


def test_the_file_says_what_was_written(tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(to_yaml(KIND), encoding="utf-8")
    found = read(path)
    assert len(found.sha256) == 64
    same = replace(found, sha256="", covariance=KIND.covariance)
    assert same == KIND
    np.testing.assert_array_equal(found.covariance, KIND.covariance)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("schema: imucal/calibration\nversion: 1\n", "not what a fleet says"),
        ("schema: imucal/fleet\nversion: 1\ndevices: 5\n", "incomplete"),
        ("just words", "not what a fleet says"),
    ],
)
def test_another_file_is_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UnreadableInput, match=words):
        read(path)
    with pytest.raises(UnreadableInput, match="no such file"):
        read(tmp_path / "none.yaml")


def test_what_the_fleet_does_not_know_stays_at_its_typical_size() -> None:
    model, data = base_model(("bias", "scale", "non_orthogonality")), tumble(1, 6)
    prior = KIND.prior(model, data, ("inclination setting",))
    names = [p.name for p in model.parameters(data.context)]
    typical = np.array([p.typical for p in model.parameters(data.context)])
    x, y = names.index("bias_x"), names.index("scale_y")
    assert (prior.mean[x], prior.mean[y]) == (3.0, 0.01)
    assert prior.covariance[x, y] == pytest.approx(0.001)
    others = [k for k in range(9) if k not in (x, y)]
    np.testing.assert_allclose(np.diag(prior.covariance)[others], typical[others] ** 2)
    np.testing.assert_array_equal(prior.mean[others], model.start(data.context)[others])
    assert prior.noise is not None
    sigma = float(np.median(data.sigma))
    assert prior.noise[0] == pytest.approx((np.log(0.02 / sigma), 0.3))
    assert prior.noise[1, 1] == pytest.approx(np.log(10.0))


def _table(path: Path, rng: np.random.Generator, count: int, bias: np.ndarray) -> None:
    """Rests in plain numpy: bias (3,) mg, squares of 2 mg/g², 1 mg of noise."""
    u = rng.standard_normal((count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    reading = 1000.0 * u + bias + 2.0 * u**2 + rng.standard_normal((count, 3))
    rows = "\n".join(",".join(f"{v:.3f}" for v in row) for row in reading)
    path.write_text(f"x (mg),y (mg),z (mg)\n{rows}\n", encoding="utf-8")


def _run(*typed: str) -> Outcome:
    return run(list(typed), Path(typed[1]).parent)


@pytest.mark.slow
def test_seven_rests_and_a_fleet_make_a_calibration(tmp_path: Path) -> None:
    """Six devices of 24 rests tell the kind; the next one needs no twelve numbers of its own. One
    that is far from the others is told so."""
    rng = np.random.default_rng(3)
    tables = []
    for k in range(6):
        tables.append(str(tmp_path / f"{k}.csv"))
        _table(Path(tables[-1]), rng, 24, 5.0 * rng.standard_normal(3))
    out, usual = tmp_path / "fleet", ("--reference", "norm", "--json")
    search = ("--only", "quadratic")
    made = _run("fleet", *tables, *usual, "-o", str(out), *search)
    assert made.code in (0, 5), made.stderr
    kind = ("--fleet", str(out / "fleet.yaml"))
    bias = np.array([4.0, -6.0, 2.0])
    few, far = tmp_path / "few.csv", tmp_path / "far.csv"
    _table(few, rng, 7, bias)
    _table(far, rng, 7, bias + 120.0)
    assert _run("lab", str(few), *usual, "--no-loop").code == 4
    done = _run("lab", str(few), *usual, *kind)
    assert done.code == 0, done.stderr
    found = {p["name"]: p for p in done.content["parameters"]}
    for axis, value in zip("xyz", bias, strict=True):
        own = found[f"bias_{axis}"]
        assert abs(own["value"] - value) < 4.0 * own["sd"]
        assert own["sd"] < 6.0
    strange = _run("lab", str(far), *usual, *kind)
    assert strange.code == 5
    assert "not of its fleet's kind" in strange.stdout
    wrong = _run("lab", str(few), "--json", *kind)
    assert wrong.code == 2
    assert "--reference norm" in wrong.stderr
