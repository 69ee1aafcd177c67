"""Calibrations: what is written is what is read, applied and believed; and what a run ends with."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from imucalib.calibration.calibration import Calibration, from_fit
from imucalib.calibration.file import VERSION, as_dict, check, from_dict, read, to_yaml, write_whole
from imucalib.calibration.findings import Findings
from imucalib.calibration.outcome import (
    ErrorSummary,
    Gate,
    HeldOutError,
    Outcome,
    list_open,
    provenance_of,
)
from imucalib.calibration.triads import Triad
from imucalib.core.effect import Context
from imucalib.core.fit import Fit, StoredParameter
from imucalib.effects import named
from imucalib.effects.record_error import record_error
from imucalib.errors import NotConverged, UnreadableInput
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.posterior.closed_loop.found import Unexplained
from imucalib.units import MG
from worlds.bench import GRAVITY, base_model, bench, draw, ordinary_theta
from worlds.places import ROOT

FACTS: dict[str, Any] = {
    "provenance": {"input": "bench.csv", "sha256": "0" * 64, "settings": {"rows": [1, 2]},
                   "seed": 3, "versions": {"numpy": "2.0"}, "time": "2024-05-06T07:08:09Z"},
    "note": "18 °C: all good",
}  # fmt: skip


@cache
def _fit() -> Fit:
    model = base_model().plus(named("temperature_bias")).plus(named("cubic"))
    model = model.plus(named("inclination_zero")).plus(record_error(2, "row 3"))
    data = bench(91, 40)
    return fit_model(model, draw(model, ordinary_theta(model, data, 92), data, 93))


@cache
def _calibration() -> Calibration:
    return from_fit(
        _fit(), "lab", raw_unit="mg", raw_to_si=9.80665e-3, gravity=GRAVITY, status="ok",
        reasons=("none: really",), facts=FACTS,
    )  # fmt: skip


def _linear() -> Calibration:
    kept = [k for k, p in enumerate(_calibration().parameters)
            if p.effect in ("mounting", "bias", "scale", "non_orthogonality")]  # fmt: skip
    return replace(
        _calibration(),
        parameters=tuple(_calibration().parameters[k] for k in kept),
        covariance=_calibration().covariance[np.ix_(kept, kept)],
        valid={},
    )


def _same(a: Calibration, b: Calibration) -> None:
    for name in ("calibrator", "parameters", "raw_unit", "raw_to_si", "gravity", "status",
                 "reasons", "valid", "facts"):  # fmt: skip
        assert getattr(a, name) == getattr(b, name), name
    assert np.array_equal(a.covariance, b.covariance)


def test_written_and_read_bit_by_bit(tmp_path: Path) -> None:
    path = tmp_path / "new" / "calibration.yaml"
    write_whole(path, to_yaml(_calibration()))
    _same(read(path), _calibration())
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "not a calibration of imucal"),
        ("- 1\n- 2\n", "not a calibration of imucal"),
        ("schema: kalibr\n", "not a calibration of imucal"),
        ("camera_model: pinhole\nintrinsics: [1, 2]\n", "not a calibration of imucal"),
        ("schema: imucal/calibration\n", "version None is not known"),
        ("schema: imucal/calibration\nversion: 999\n", "version 999 is not known"),
        ("schema: imucal/calibration\nversion: 3\n", "damaged"),
        ("a: [1, 2\n", "not a YAML file"),
        ("\tx: 1\n", "not a YAML file"),
    ],
)
def test_foreign_files_are_refused(tmp_path: Path, text: str, what: str) -> None:
    path = tmp_path / "other.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UnreadableInput) as caught:
        read(path)
    assert what in caught.value.what
    assert caught.value.where == str(path)


def test_a_changed_digit_is_refused_until_the_sum_is_deleted(tmp_path: Path) -> None:
    text, path = to_yaml(_linear()), tmp_path / "c.yaml"
    at = text.index("value: ") + len("value: -0.0")
    changed = text[:at] + ("7" if text[at] != "7" else "8") + text[at + 1 :]
    path.write_text(changed, encoding="utf-8")
    with pytest.raises(UnreadableInput, match=r"changed after it was written.*first line"):
        read(path)
    path.write_text(changed.partition("\n")[2], encoding="utf-8")
    assert read(path).parameters[0].value != _linear().parameters[0].value
    path.write_bytes(text.replace("\n", "\r\n").encode())
    _same(read(path), _linear())


@pytest.mark.parametrize("key", ["parameters", "covariance", "raw", "valid"])
@pytest.mark.parametrize("bad", [None, "text", 3, [1, 2]])
def test_a_wrong_block_is_refused(key: str, bad: Any) -> None:
    content = as_dict(_calibration())
    content[key] = bad
    with pytest.raises(UnreadableInput, match="damaged"):
        from_dict(content, "file.yaml")


@pytest.mark.parametrize("size", [1e300, -1e300, 1e-300, float("nan"), float("inf")])
@pytest.mark.parametrize("place", [("parameters", 0, "value"), ("raw", "to_m_per_s2")])
def test_a_number_without_a_variance_is_refused(place: tuple[Any, ...], size: float) -> None:
    content = as_dict(_calibration())
    block: Any = content
    for key in place[:-1]:
        block = block[key]
    block[place[-1]] = size
    with pytest.raises(UnreadableInput, match="damaged"):
        from_dict(content, "file.yaml")


@pytest.mark.parametrize("rows", [[[1.0], [0.0, 4.0, 0.0]], [[1.0]], [[1.0], [0.0, 9.0]]])
def test_the_covariance_of_an_effect_fits_its_parameters(rows: list[list[float]]) -> None:
    parameters = [{"name": n, "unit": "mg", "value": 0.0, "sd": s} for n, s in (("a", 1), ("b", 2))]
    block = {"effect": "gyro_delay", "parameters": parameters, "covariance": rows}
    with pytest.raises(UnreadableInput, match="damaged"):
        from_dict({**as_dict(_calibration()), "effects": [block]}, "file.yaml")


def test_content_that_contradicts_itself_is_refused() -> None:
    good = _calibration()
    covariance = good.covariance.copy()
    covariance[0, 1] *= 3.0
    with pytest.raises(UnreadableInput, match="symmetric"):
        check(replace(good, covariance=covariance), "f")
    with pytest.raises(UnreadableInput, match="contradict"):
        check(replace(good, covariance=2.0 * good.covariance), "f")
    sd = np.array([p.sd for p in good.parameters])
    wrong = np.diag(sd**2)
    wrong[0, 1] = wrong[1, 0] = 2.0 * sd[0] * sd[1]
    with pytest.raises(UnreadableInput, match="not positive"):
        check(replace(good, covariance=wrong), "f")
    singular = np.diag(np.full(12, 1e-8))
    singular[0, 1] = singular[1, 0] = 2e-8
    triad = Triad("imu0", np.eye(3), np.eye(3), np.zeros(3), np.eye(3), np.zeros(3), singular, 0.0,
                  0.0)  # fmt: skip
    with pytest.raises(UnreadableInput, match="not positive"):
        check(replace(good, triads=(triad,)), "f")
    flat = tuple(replace(p, value=-1.0) if p.name == "scale_x" else p for p in good.parameters)
    with pytest.raises(UnreadableInput, match="inverted"):
        check(replace(good, parameters=flat), "f")


def test_apply_is_the_models_correction() -> None:
    fit, calibration = _fit(), _calibration()
    model, theta = calibration.model()
    assert "inclination_zero" not in model.names
    data = fit.observations
    assert np.array_equal(
        calibration.apply(data.reading[:, 0], data.context),
        model.correct(theta, data.reading, data.context)[:, 0],
    )
    # Undoing the sensor gives back a force: forwards again, it is the reading.
    corrected = calibration.apply(data.reading[:, 0], data.context)
    again = model.predict(theta, corrected[:, None], data.context).reading
    assert np.allclose(again, data.reading, atol=1e-10)


def test_apply_refuses_readings_that_no_force_gives() -> None:
    """A negative square bends back: beyond the bend no force gives the reading."""
    bent = tuple(StoredParameter(p.name, "quadratic", "sensor", -150.0, 1.0, p.unit)
                 for p in named("quadratic").parameters(Context(1)))  # fmt: skip
    calibration = replace(_calibration(), parameters=bent, covariance=np.eye(3))
    assert np.all(np.isfinite(calibration.apply(np.full((1, 3), 10.0), unit="m/s2")))
    with pytest.raises(NotConverged) as caught:
        calibration.apply(np.full((1, 3), 60.0), unit="m/s2")
    assert caught.value.remedy


@pytest.mark.parametrize("before", [None, "kept"])
def test_an_interrupted_write_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: str | None
) -> None:
    path = tmp_path / "calibration.yaml"
    if before:
        path.write_text(before)

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", stop)
    with pytest.raises(KeyboardInterrupt):
        write_whole(path, to_yaml(_calibration()))
    assert [p.name for p in tmp_path.iterdir()] == ([path.name] if before else [])
    if before:
        assert path.read_text() == before


ERROR = ErrorSummary("error, rms", "mg", 9.0, 3.0, 1.0, 0.5, HeldOutError(9.0, 3.0, 2.0))
NAMELESS = Unexplained("slow changes", "order", "probe", 0.99, 9.0)


def outcome(findings: Findings, size: float = 0.0) -> Outcome:
    made = provenance_of(path="t", sha256="", samples=3, mapping={}, settings={})
    left = list_open(SimpleNamespace(open_size=MG * size), ERROR)  # type: ignore[arg-type]
    return Outcome("lab", (ERROR,), made, findings, left=left)


@pytest.mark.parametrize(("size", "code"), [(1.9, 0), (2.1, 5)])
def test_an_open_question_counts_where_it_is_larger_than_what_the_result_is_good_to(
    size: float, code: int
) -> None:
    found = outcome(Findings("unexplained", unexplained=(NAMELESS,)), size)
    assert found.exit_code == code
    assert found.status == ("marginal" if code else "ok")
    assert ("more than" in found.left[0].sentence) == (code == 5)


@pytest.mark.parametrize(
    ("findings", "gates"),
    [
        (Findings("not run"), {"suspected", "unexplained", "caution"}),
        (None, {"suspected", "unexplained", "caution"}),
        (Findings("nothing missing"), set()),
        (Findings("explained"), set()),
        (Findings("suspected"), {"suspected", "unexplained", "caution"}),
        (Findings("unexplained", unexplained=(NAMELESS,)), {"unexplained", "caution"}),
    ],
)
def test_gates_are_stricter(findings: Findings | None, gates: set[Gate]) -> None:
    found = outcome(findings)
    assert found.exit_code == 0
    for gate in ("suspected", "unexplained", "caution"):
        strict = replace(found, fail_on=gate)  # type: ignore[arg-type]
        assert strict.exit_code == (5 if gate in gates else 0)
        assert bool(strict.gate_reason) == (gate in gates)


def test_the_page_of_formats_states_the_version_that_is_written() -> None:
    page = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    assert f"| `schema`, `version` | `imucal/calibration`, {VERSION} |" in page
