"""Laws that every reader found in the readers' folder obeys."""

import os
import random
import tracemalloc
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from imucalib import readers, writers
from imucalib.errors import ImucalError, UnreadableInput
from imucalib.recording.mapping import FieldMapping, from_dict
from imucalib.recording.recording import Channel, Recording
from worlds.bag_logs import BagWriter

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
        writer.write(recording, path)
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
    assert back.start_ns == example.recording.start_ns
    assert back.gaps == ()
    assert back.sha256 == readers.sha256_of(example.path)
    assert not list(tmp_path.glob(".*")), "a temporary file was left behind"


@BY_FORMAT
def test_blocks_joined_are_the_whole(pair: Pair, tmp_path: Path) -> None:
    example = written(pair, tmp_path, 700)
    parts = list(readers.blocks(example.path, block_samples=64))
    assert len(parts) > 1
    for name, channel in example.recording.channels.items():
        pieces = [p.channels[name] for p in parts if name in p.channels]
        np.testing.assert_array_equal(np.concatenate([p.values for p in pieces]), channel.values)


@BY_FORMAT
def test_the_resolved_mapping_reads_the_same(pair: Pair, tmp_path: Path) -> None:
    example = written(pair, tmp_path, 300)
    first = readers.read(example.path)
    same(first, readers.read(example.path, from_dict(first.mapping)))


def outcome(path: Path) -> Recording | ImucalError:
    try:
        return readers.read(path)
    except ImucalError as error:
        return error


@pytest.mark.slow
@BY_FORMAT
def test_a_cut_file_is_told(pair: Pair, tmp_path: Path) -> None:
    example = written(pair, tmp_path, 24)
    data = example.path.read_bytes()
    cut = tmp_path / f"cut{example.path.suffix}"
    step = max(1, len(data) // 1000)
    for size in range(1, len(data), step):
        cut.write_bytes(data[:size])
        result = outcome(cut)
        if isinstance(result, ImucalError):
            assert isinstance(result, UnreadableInput)
            continue
        whole = example.recording
        lost = any(
            name not in result.channels or result.channels[name].t.size < c.t.size
            for name, c in whole.channels.items()
        )
        assert result.notes or not lost, f"{size} of {len(data)} bytes: a loss without a note"
        for name, channel in result.channels.items():
            n = channel.t.size
            np.testing.assert_array_equal(channel.values, whole.channels[name].values[:n])


@pytest.mark.slow
@BY_FORMAT
def test_a_flipped_byte_is_no_traceback(pair: Pair, tmp_path: Path) -> None:
    example = written(pair, tmp_path, 24)
    data = example.path.read_bytes()
    rng = random.Random(1)
    damaged = tmp_path / f"flip{example.path.suffix}"
    positions = range(len(data)) if len(data) < 700 else rng.sample(range(len(data)), 700)
    for position in positions:
        broken = bytearray(data)
        broken[position] ^= 1 << rng.randrange(8)
        damaged.write_bytes(bytes(broken))
        outcome(damaged)


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


def test_an_empty_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "empty.csv"
    path.touch()
    with pytest.raises(UnreadableInput, match=r"empty\.csv: the file is empty"):
        readers.read(path)


@pytest.mark.parametrize("suffix", ["", *(r.suffixes[0] for r in readers.readers())])
def test_a_directory_is_named(suffix: str, tmp_path: Path) -> None:
    folder = tmp_path / f"folder{suffix}"
    folder.mkdir()
    with pytest.raises(UnreadableInput, match=r"folder.*directory"):
        readers.read(folder)


def test_a_bag_folder_without_its_files_is_named(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9}\n")
    with pytest.raises(UnreadableInput, match="bag cannot be opened"):
        readers.read(tmp_path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(UnreadableInput, match=r"absent\.csv.*No such file"):
        readers.read(tmp_path / "absent.csv")


@pytest.mark.parametrize("suffix", [r.suffixes[0] for r in readers.readers()])
def test_a_pipe_does_not_block(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"pipe{suffix}"
    os.mkfifo(path)
    with pytest.raises(UnreadableInput, match="not a regular file"):
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
def test_ten_minutes_take_no_more_memory_than_five(pair: Pair, tmp_path: Path) -> None:
    (tmp_path / "five").mkdir()
    five = peak_of_blocks(written(pair, tmp_path / "five", 30_000).path)
    ten = peak_of_blocks(written(pair, tmp_path, 60_000).path)
    assert ten < 1.2 * five
    assert ten < 32e6


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
