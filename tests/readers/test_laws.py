"""Laws that every reader obeys, also in blocks and from another package."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from imucalib import readers, writers
from imucalib.calibration import apply as application
from imucalib.calibration.apply import apply_to_recording, correct_file
from imucalib.errors import ImucalError, UnreadableInput, UsageError
from imucalib.file_hash import sha256_of
from imucalib.recording.mapping import FieldMapping, from_dict
from imucalib.recording.recording import Channel, Recording
from imucalib.writers import write, write_blocks
from worlds.bag_logs import BagWriter
from worlds.recordings import recording_of
from worlds.stated import stated

Pair = tuple[readers.Reader, writers.Writer]
PAIRS: list[Pair] = [
    (r, w) for r in readers.readers() for w in writers.writers() if r.name == w.name
]
BAG = next(r for r in readers.readers() if r.name == "rosbag")
#: Formats that are only read: tests write them.
BAGS: list[Pair] = [(BAG, BagWriter((".bag",))), (BAG, BagWriter((".db3",)))]
BY_NAME = pytest.mark.parametrize("pair", PAIRS, ids=lambda p: p[0].name)
BY_FORMAT = pytest.mark.parametrize("pair", [*PAIRS, *BAGS], ids=lambda p: p[1].suffixes[0])


def made(n: int, seed: int = 0, rate: float = 100.0) -> Recording:
    """Two triads with gyroscopes, one thermometer, at rest in turns; a start time."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) / rate
    channels = {}
    for k in range(2):
        acc = np.array([0.0, 0.0, 9.8]) + rng.normal(scale=0.02, size=(n, 3))
        rates = rng.normal(scale=0.01, size=(n, 3))
        name = f"imu{k}"
        channels[f"{name}/acceleration"] = Channel(t, acc, "m/s2", "acceleration", name, rate)
        channels[f"{name}/angular_rate"] = Channel(t, rates, "rad/s", "angular_rate", name, rate)
    warm = 20.0 + 0.01 * t[:, None]
    channels["imu0/temperature"] = Channel(t, warm, "degC", "temperature", "imu0", rate)
    return Recording(channels, "made", "made", "", start_ns=1_700_000_000_123_456_789)


@dataclass(frozen=True)
class Example:
    path: Path
    recording: Recording


def written(pair: Pair, folder: Path, n: int) -> Example:
    _, writer = pair
    path = folder / f"a{writer.suffixes[0]}"
    recording = made(n)
    if isinstance(writer, BagWriter):  # a bag's thermometer is not told from other numbers
        channels = {k: c for k, c in recording.channels.items() if c.quantity != "temperature"}
        recording = replace(recording, channels=channels)
        writer.write_blocks([recording], path)
    else:
        writers.write(recording, path)
    return Example(path, recording)


def same(one: Recording, two: Recording) -> None:
    assert set(one.channels) == set(two.channels)
    for name, channel in one.channels.items():
        other = two.channels[name]
        # MCAP keeps integer nanoseconds; text and HDF5 keep the float itself.
        np.testing.assert_allclose(other.t, channel.t, rtol=0, atol=1e-9, err_msg=name)
        np.testing.assert_array_equal(other.values, channel.values, err_msg=name)
        assert (other.unit, other.quantity, other.triad) == (
            channel.unit,
            channel.quantity,
            channel.triad,
        )


@BY_FORMAT
def test_what_was_written_is_read_back(pair: Pair, tmp_path: Path) -> None:
    example = written(pair, tmp_path, 700)
    back = readers.read(example.path)
    same(example.recording, back)
    same(back, readers.read(example.path, from_dict(back.mapping)))
    assert back.start_ns == example.recording.start_ns
    assert back.gaps == ()
    assert back.sha256 == sha256_of(example.path)
    assert not list(tmp_path.glob(".*")), "a temporary file was left behind"


@BY_FORMAT
def test_blocks_joined_are_the_whole(pair: Pair, tmp_path: Path) -> None:
    example = written(pair, tmp_path, 700)
    parts = list(readers.blocks(example.path, block_samples=64))
    assert len(parts) > 1
    for name, channel in example.recording.channels.items():
        pieces = [p.channels[name] for p in parts if name in p.channels]
        np.testing.assert_array_equal(np.concatenate([p.values for p in pieces]), channel.values)


def outcome(path: Path) -> Recording | ImucalError:
    try:
        return readers.read(path)
    except ImucalError as error:
        return error


FOREIGN = {
    "png": b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 20,
    "zip": b"PK\x03\x04" + bytes(range(256)) * 20,
    "text": b"The quick brown fox jumps over the lazy dog.\nAnd again.\n" * 20,
    "zeros": bytes(5000),
    "json": b'{"a": [1, 2, 3], "b": "x"}\n',
    "one byte": b"1",
    "gzip magic": b"\x1f\x8b",
}


@pytest.mark.parametrize("kind", FOREIGN)
@pytest.mark.parametrize("suffix", [".bin", *(r.suffixes[0] for r in readers.readers())])
def test_foreign_bytes_are_refused(kind: str, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"foreign{suffix}"
    path.write_bytes(FOREIGN[kind])
    with pytest.raises(UnreadableInput, match=r"foreign"):
        readers.read(path)


@pytest.mark.parametrize("reader", readers.readers(), ids=lambda r: r.name)
def test_random_bytes_after_a_true_start_are_no_traceback(
    reader: readers.Reader, tmp_path: Path
) -> None:
    rng = random.Random(2)
    starts = {
        "mcap": b"\x89MCAP0\r\n", "hdf5": b"\x89HDF\r\n\x1a\n", "csv": b"1,2,3\n",
        "rosbag": b"#ROSBAG V2.0\n",
    }  # fmt: skip
    path = tmp_path / f"a{reader.suffixes[0]}"
    for size in (1, 8, 100, 5000):
        path.write_bytes(starts.get(reader.name, b"") + rng.randbytes(size))
        assert isinstance(outcome(path), UnreadableInput)


def bag_folder(path: Path) -> None:
    path.mkdir()
    (path / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9}\n")


@pytest.mark.parametrize("suffix", ["", *(r.suffixes[0] for r in readers.readers())])
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (Path.touch, "the file is empty"),
        (Path.mkdir, "directory"),
        (os.mkfifo, "not a regular file"),
        (bag_folder, "bag cannot be opened"),
        (lambda path: None, "No such file"),
    ],
)
def test_what_is_no_recording_is_named(
    make: Callable[[Path], object], words: str, suffix: str, tmp_path: Path
) -> None:
    path = tmp_path / f"odd{suffix}"
    make(path)
    with pytest.raises(UnreadableInput, match=f"odd{suffix}.*{words}"):
        readers.read(path)


@pytest.mark.parametrize("suffix", [r.suffixes[0] for r in readers.readers()])
def test_a_forbidden_file_is_named(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"secret{suffix}"
    path.write_text("1,2,3\n")
    path.chmod(0)
    readers.readers()  # what is imported now need not be readable for the child
    if os.geteuid():
        with pytest.raises(UnreadableInput, match=r"secret.*[Pp]ermission"):
            readers.read(path)
    else:
        child = os.fork()  # root may read everything, its child gives that up
        if child == 0:
            try:
                os.setuid(65534)
                readers.read(path)
            except UnreadableInput as error:
                os._exit(0 if "ermission" in str(error) and "secret" in str(error) else 2)
            finally:
                os._exit(1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def peak_of_blocks(path: Path) -> int:
    """Most bytes in use while a file is read in blocks."""
    tracemalloc.start()
    try:
        for _ in readers.blocks(path, block_samples=4096):
            pass
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.slow
@BY_NAME
def test_twenty_minutes_take_no_more_memory_than_ten(pair: Pair, tmp_path: Path) -> None:
    (tmp_path / "ten").mkdir()
    ten = peak_of_blocks(written(pair, tmp_path / "ten", 60_000).path)
    twenty = peak_of_blocks(written(pair, tmp_path, 120_000).path)
    assert twenty < 1.2 * ten
    assert twenty < 32e6


@BY_NAME
def test_a_failed_write_leaves_the_old_file(pair: Pair, tmp_path: Path) -> None:
    example = written(pair, tmp_path, 50)
    before = example.path.read_bytes()
    with pytest.raises(ImucalError):
        writers.write(Recording({}, "made", "made", ""), example.path)
    assert example.path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == [example.path.name]


def test_an_unknown_suffix_is_refused_when_writing(tmp_path: Path) -> None:
    with pytest.raises(ImucalError, match="no writer"):
        writers.write(made(10), tmp_path / "a.xyz")


def test_a_mapping_that_names_nothing_in_the_file_is_refused(tmp_path: Path) -> None:
    for reader, writer in PAIRS:
        path = tmp_path / f"a{writer.suffixes[0]}"
        writers.write(made(50), path)
        with pytest.raises(ImucalError, match="nothing_like_this"):
            readers.read(path, FieldMapping(acc=("nothing_like_this",) * 3))
        assert reader.recognises(path, path.read_bytes()[:65536])


CALIBRATION = stated({"bias": (20.0, -35.0, 5.0)})


def recording(n: int, first: int = 0) -> Recording:
    t = (first + np.arange(n)) / 100.0
    values = 9.8 * np.stack([np.sin(t), np.cos(t), 0.01 * np.ones(n)], axis=1)
    return recording_of(t, values, warm=20.0 + 0.0 * t, hz=100.0, start_ns=1_700_000_000 * 10**9)


@pytest.mark.parametrize("source", ["a.csv", "a.h5", "a.mcap"])
@pytest.mark.parametrize("target", ["b.csv", "b.h5", "b.mcap"])
def test_block_by_block_is_the_same(
    tmp_path: Path, source: str, target: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = lambda path, mapping, strict: readers.blocks(  # noqa: E731
        path, mapping, block_samples=97, strict=strict
    )
    monkeypatch.setattr(application, "blocks", small)
    write(recording(1000), tmp_path / source)
    correct_file(CALIBRATION, tmp_path / source, tmp_path / target, FieldMapping())
    at_once = apply_to_recording(CALIBRATION, readers.read(tmp_path / source))
    back = readers.read(tmp_path / target)
    assert set(back.channels) == set(at_once.channels)
    for name, channel in at_once.channels.items():
        np.testing.assert_array_equal(back.channels[name].values, channel.values)
        np.testing.assert_allclose(back.channels[name].t, channel.t, rtol=0, atol=1e-9)


@pytest.mark.parametrize("suffix", [".csv", ".mcap"])
def test_channels_that_change_do_not_fit_a_table(tmp_path: Path, suffix: str) -> None:
    one, two = recording(10), recording(10, 10)
    less = replace(one, channels={"imu0/acceleration": one.channels["imu0/acceleration"]})
    with pytest.raises(UsageError, match="channels change"):
        write_blocks([less, two], tmp_path / f"a{suffix}")
    assert not (tmp_path / f"a{suffix}").exists()
    for kind in (suffix, ".h5"):
        write_blocks([one, replace(two, channels=less_of(two))], tmp_path / f"b{kind}")
        back = readers.read(tmp_path / f"b{kind}")
        assert back.channels["imu0/acceleration"].t.size == 20
        assert back.channels["imu0/temperature"].t.size == 10


def less_of(whole: Recording) -> dict[str, Channel]:
    return {"imu0/acceleration": whole.channels["imu0/acceleration"]}


READER = """
from imucalib.readers.fields.joining import join
from imucalib.recording.recording import Channel, Recording
import numpy as np


class TallyReader:
    name, suffixes = "tally", (".tally",)

    def recognises(self, path, head):
        return head.startswith(b"TALLY1")

    def read(self, path, mapping, *, strict):
        return join(self.blocks(path, mapping, block_samples=9, strict=strict), str(path))

    def blocks(self, path, mapping, *, block_samples, strict):
        values = np.frombuffer(path.read_bytes()[6:]).reshape(-1, 3)
        t = np.arange(len(values)) / 50.0
        channel = Channel(t, values, "m/s2", "acceleration", "imu0", 50.0)
        yield Recording({"imu0/acceleration": channel}, str(path), self.name, "0" * 64, None)


READER = TallyReader()
"""


def test_a_reader_of_another_package_reads_its_files(tmp_path: Path) -> None:

    site, log = tmp_path / "site", tmp_path / "one.log"
    facts = site / "tally_reader-1.0.dist-info"
    facts.mkdir(parents=True)
    (site / "tally_reader.py").write_text(READER)
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: tally-reader\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text("[imucal.readers]\ntally = tally_reader:READER\n")
    rng = np.random.default_rng(1)
    log.write_bytes(b"TALLY1" + (rng.normal((0.0, 0.0, 9.81), 0.02, (500, 3))).tobytes())
    code = f"import sys; sys.path.insert(0, {str(site)!r}); from imucalib.cli import main; main()"
    run = [sys.executable, "-c", code, "inspect", str(log), "--json"]
    found = subprocess.run(run, capture_output=True, text=True, check=True).stdout
    assert '"format": "tally"' in found
    assert "imu0/acceleration" in found
