"""Slips of a new user: each says what, where, and what to do, and never ends in a crash."""

from __future__ import annotations

import re
import shutil
import sys
import zipfile
from pathlib import Path

import pytest

from imucalib import cli
from worlds.places import SAMPLES

#: File -> bytes of what somebody gives in the place of a recording.
JUNK = {
    "photo.png": b"\x89PNG\r\n\x1a\n" + bytes(64),
    "paper.pdf": b"%PDF-1.7\n" + bytes(64),
    "page.csv": b"<!DOCTYPE html><html><body>404</body></html>",
    "a.npy": b"\x93NUMPY\x01\x00" + bytes(64),
    "prog": b"\x7fELF" + bytes(64),
    "lfs.csv": b"version https://git-lfs.github.com/spec/v1\noid sha256:abc\nsize 12\n",
    "d.json": b'{"a": [1, 2, 3]}',
    "junk.bin": bytes(range(1, 200)),
    "empty.csv": b"",
    "head.csv": b"x,y,z\n",
    "bare.csv": b"inclination,tool_face,x,y,z\n",
    "twice.csv": b"inclination,tool_face,x,y,y\n0,0,1,2,3\n",
    "huge.csv": b"inclination,tool_face,x_mg,y_mg,z_mg\n0,0,1,2,1000\n0,90,1e300,2,3\n",
    "page.html": b"<html>\n<p role='region' aria-label='U, k: Results'>\n</html>\n",
    "note.txt": b"Dear colleague,\nit was on the bench on Monday.\n",
}
#: What is typed -> what the answer must hold: what is wrong, and what to do about it.
SLIPS = {
    "photo.png": ("this is a picture", "give the recording"),
    "paper.pdf": ("this is a PDF document", "export the table as CSV"),
    "inspect page.csv": ("this is a web page", "give the recording"),
    "lab page.csv": ("this is a web page", "give the recording"),
    "a.npy": ("an array of NumPy", "numpy.savetxt"),
    "prog": ("this is a program", "give the recording"),
    "z.zip": ("zip archive", "unpack it"),
    "lfs.csv": ("a pointer of Git LFS", "git lfs pull"),
    "d.json": ("this is JSON", "export the table as CSV"),
    "junk.bin": ("starts with the bytes 01 02 03", "readable formats: csv"),
    "actigraph junk.bin": ("starts with the bytes 01 02 03", "readable formats: csv"),
    "empty.csv": ("0 bytes", "copy it again"),
    "head.csv": ("no table of numbers", "give --skip"),
    "note.txt": ("no table of numbers", "give --skip"),
    "lab bare.csv": ("a heading but no rows", "a row a position"),
    "lab twice.csv": ("two columns have the same heading 'y'", "rename one"),
    "lab huge.csv": ("row 2, column x_mg", "'1e300' is too large", "--exclude 2"),
    "export page.html --to matlab": ("not a YAML file: .{,80}, line [0-9]+", "that a calibrating"),
    "validate photo.png": ("not a YAML file, nor any other text", "calibration.yaml that"),
    "lab paper_table_1.csv --max-gyro-error 3": (
        "imucal lab has no limit --max-gyro-error; there are .*--max-toolface-error",
    ),
    "batch paper_table_1.csv -o entries -- --max-gyro-error 3": (
        "imucal actigraph has no limit --max-gyro-error; there are .*--max-worst-error",
    ),
    "inspect paper_table_1.csv --max-error 3": ("imucal inspect has no limit .*it has none",),
    "lab paper_table_1.csv --swap 3": ("not two rows", "for example --swap 3,10"),
    "apply calibration.yaml cave_ai.csv -o none/a.csv": ("cannot be written", "may write"),
    "folder": ("this is a directory", "imucal batch folder"),
    "lab folder": ("no such file|directory", "check the path|imucal batch"),
    "missing.csv": ("No such file", "check the path"),
    "calibrate": ("no command 'calibrate'", "imucal lab +Calibrate"),
    "clibrate": ("no command 'clibrate'", "imucal lab +Calibrate"),
    "actigraph paper_table_1.csv": ("no acceleration columns", "imucal paper_table_1.csv says"),
    "lab turns.csv.gz": ("no column for inclination", "imucal turns.csv.gz says"),
    "lab paper_table_1.csv --gravity 9.81m/s2": ("not a valid float", "9.81, without the unit"),
    "lab paper_table_1.csv --fix 10:y -58593": ("No such option '-5'", "--fix 10:y=-58593"),
    "convert rests.mcap": ("Missing argument 'TARGET'", "For example: imucal convert log.csv"),
    "aply": ("no command 'aply'", "Did you mean 'apply'"),
    "info": ("no command 'info'", "Did you mean 'inspect'"),
    "hlp": ("no command 'hlp'", "Did you mean 'help'"),
    "lab": ("Missing argument 'TABLE", "For example: imucal lab positions.csv"),
    "lab cave_ai.csv": ("no column for inclination", "add --reference norm"),
    "lab positions.csv": ("no column for x, y, z", "--recording LOG"),
    "lab rests.mcap": ("not a text file", "--reference norm"),
    "lab paper_table_1.csv --gravity 9,81": ("not a valid float", "9.81, with a point"),
    "lab paper_table_1.csv --gravity 98": ("between 9.7 and 9.9", "For example: imucal lab"),
    "lab paper_table_1.csv --lattitude 59": ("--lattitude", "--latitude"),
    "lab paper_table_1.csv --fix 10:y": ("10:y", "for example 10:y=-58593"),
    "lab paper_table_1.csv --fix 100:y=3": ("--fix 100:y: no such cell", "rows are 1..32"),
    "lab paper_table_1.csv --exclude ten": ("'ten'", "a range such as 1-20"),
    "lab paper_table_1.csv --unit G": ("the norm would be", "check --unit"),
    "lab paper_table_1.csv --declare inclination_zeo": ("inclination_zeo", "inclination_zero"),
    "lab calibration.yaml": ("this is a calibration", "validate, apply and export take it"),
    "lab paper_table_1.csv -o cave_ai.csv": ("is a file", "For example: imucal lab"),
    "actigraph cave_ai.csv": ("neither time stamps nor a sample rate", "give --rate"),
    "actigraph turns.csv.gz --every 7": ("'7' is not a time", "7d or 12h"),
    "imu rests.mcap": ("no gyroscope", "--gyro X,Y,Z"),
    "array turns.csv.gz": ("Missing option '--board'", "--board board.yaml"),
    "array turns.csv.gz --board nope": ("no board 'nope'", "one of: mimu4444"),
    "apply rests.mcap calibration.yaml -o o.mcap": ("rests.mcap", "before any recording"),
    "apply calibration.yaml rests.mcap": ("Missing option '-o'", "-o corrected.mcap"),
    "apply calibration.yaml rests.mcap -o o.txt": ("no writer for this suffix", ".mcap"),
    "export calibration.yaml --to c": ("'c' is none of", "c-header"),
    "export cave_ai.csv --to matlab": ("not a calibration|not a YAML", "calibration.yaml that"),
    "check calibration.yaml": ("Missing argument 'LOG'", "For example: imucal check"),
    "compare calibration.yaml": ("nothing to compare with", "name two or more"),
    "validate gone.yaml": ("gone.yaml: no such file", "check the path"),
    "batch nothing -o x": ("nothing: no such file or folder", "name recordings"),
    "effects inclination": ("no effect is called 'inclination'", "inclination_zero|effects"),
    "simulate lb": ("No such command 'lb'", "imucal simulate lab"),
    "convert rests.mcap a.xyz": ("no writer for this suffix", "use one of"),
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what a new user has at hand."""
    folder = tmp_path_factory.mktemp("first")
    for name in ("cave_ai.csv", "paper_table_1.csv", "positions.csv", "rests.mcap", "turns.csv.gz"):
        shutil.copy(SAMPLES / name, folder)
    (folder / "folder").mkdir()
    shutil.copy(SAMPLES / "cave_ai.csv", folder / "folder")
    for name, content in JUNK.items():
        (folder / name).write_bytes(content)
    with zipfile.ZipFile(folder / "z.zip", "w") as archive:
        archive.writestr("a.csv", "x,y,z\n1,2,3\n")
    line = ["lab", str(folder / "cave_ai.csv"), "--reference", "norm", "--no-loop", "-q"]
    cli.cli.main([*line, "-o", str(folder / "made")], standalone_mode=False)
    shutil.copy(folder / "made" / "calibration.yaml", folder)
    return folder


@pytest.mark.parametrize("typed", SLIPS)
def test_a_slip_says_what_where_and_what_to_do(
    typed: str,
    place: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(place)
    monkeypatch.setattr(sys, "argv", ["imucal", *typed.split()])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    said = " ".join(capsys.readouterr().err.split())
    assert ended.value.code in (2, 3), said
    for wanted in SLIPS[typed]:
        assert re.search(wanted, said), said
    words = [*typed.split(), *re.findall(r"'([^' ]+)", said)]
    assert any(word in said for word in words)
    assert "Traceback" not in said
