"""Headings of the trade in German, French and Spanish: the same table, the same calibration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.lab.headings import bare
from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.readers import read
from worlds.command import run
from worlds.places import SAMPLES

ROWS = [r for r in (SAMPLES / "paper_table_1.csv").read_text().splitlines() if r[0] != "#"]
TURNS = 200

TABLES = {
    "German": "Neigung (Grad),Werkzeugwinkel (Grad),Beschleunigung x,Beschleunigung y,z-Achse",
    "German, Latin": "Inklination [°],Werkzeugfläche [°],roh x,roh y,roh z",
    "French": "Inclinaison (degrés),Face outil (degrés),accélération x,accélération y,axe z",
    "French, long": "Angle d'inclinaison (°),Face de l'outil (°),brut x,brut y,brut z",
    "Spanish": "Inclinación (grados),Cara de herramienta (grados),acel. x,aceleración y,eje z",
    "Spanish, ordinal": "Inclinación (º),Cara de la herramienta (º),x,y,z",
    "English": "Incl (deg),HSTF (deg),x,y,z",
}


@pytest.mark.parametrize("heading", TABLES.values(), ids=TABLES)
def test_a_table_is_read_under_the_headings_of_the_trade(heading: str, tmp_path: Path) -> None:
    file = tmp_path / "t.csv"
    file.write_text("\n".join([heading, *ROWS[1:]]) + "\n", encoding="utf-8")
    found, same = read_position_table(file), read_position_table(SAMPLES / "paper_table_1.csv")
    for role in ("inclination", "tool_face", "x", "y", "z"):
        np.testing.assert_array_equal(found.columns[role], same.columns[role])
    assert {found.unit["inclination"], found.unit["tool_face"]} <= {"deg", "°"}


@pytest.mark.parametrize(
    ("heading", "zero"),
    [
        ("Neigung (Grad von der Senkrechten)", "vertical"),
        ("Inclinaison (° par rapport à la verticale)", "vertical"),
        ("Inclinaison (° depuis l'horizontale)", "horizontal"),
        ("Inclinación (º desde la vertical)", "vertical"),
        ("Inclinación (grados desde la horizontal)", "horizontal"),
    ],
)
def test_where_an_inclination_counts_from_is_understood(heading: str, zero: str) -> None:
    assert bare(heading).zero == zero
    assert bare(heading).name in ("neigung", "inclinaison", "inclinacion")


def test_an_inclination_from_another_zero_than_the_runs_is_asked_about(tmp_path: Path) -> None:
    text = (SAMPLES / "paper_table_1.csv").read_text()
    path = tmp_path / "t.csv"
    path.write_text(text.replace("inclination_deg", "Inclination (deg from vertical)"))
    assert "--inclination-zero vertical" in str(run("lab", path, "--no-loop").exception)


@pytest.mark.parametrize(
    "heading",
    [
        "Zeit (s);Beschleunigung x (g);Beschleunigung y (g);Beschleunigung z (g);Temperatur (°C)",
        "temps (s);accélération x (g);accélération y (g);accélération z (g);température (°C)",
        "Temps;accélération x (g);accélération y (g);accélération z (g);température (°C)",
        "tiempo (s);aceleración x (g);aceleración y (g);aceleración z (g);temperatura (ºC)",
        "time (s);acc x (g);acc y (g);acc z (g);temps (°C)",
    ],
)
def test_a_recording_is_read_under_them(heading: str, tmp_path: Path) -> None:
    file = tmp_path / "r.csv"
    rows = (f"{k / 100:.2f};0.01;0.{k % 10};1.00;21.{k % 10}" for k in range(TURNS))
    file.write_text("\n".join([heading, *rows]) + "\n", encoding="utf-8")
    found = read(file)
    assert {c.quantity for c in found.channels.values()} == {"acceleration", "temperature"}
    channel = next(c for c in found.channels.values() if c.quantity == "acceleration")
    assert channel.values.shape == (TURNS, 3)
    assert channel.t[-1] == pytest.approx((TURNS - 1) / 100)
