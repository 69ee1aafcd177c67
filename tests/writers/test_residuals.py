"""`apply --residuals`: what rests read before and after, by other programs' readers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from imucalib.errors import UsageError
from imucalib.recording.recording import Channel, Recording
from imucalib.writers import write
from imucalib.writers.residuals import residual_files
from worlds.command import run

GRAVITY, RATE, STILL, BIAS = 9.80665, 100.0, 25.0, np.array([0.05, -0.03, 0.02])
#: Positions at rest, of a sensor whose only error is its bias.
UPS = np.random.default_rng(0).normal(size=(24, 3))
UPS /= np.linalg.norm(UPS, axis=1)[:, None]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of rests, its calibration and the residuals in one folder."""
    folder, rng = tmp_path_factory.mktemp("residuals"), np.random.default_rng(1)
    still, moving = int(STILL * RATE), int(1.0 * RATE)
    parts = []
    for k, up in enumerate(UPS):
        share = np.linspace(0.0, 1.0, moving)[:, None]
        after = UPS[(k + 1) % len(UPS)]
        parts += [np.tile(up, (still, 1)), (1.0 - share) * up + share * after]
    values = GRAVITY * np.concatenate(parts) + BIAS
    values += rng.normal(0.0, 0.003, values.shape)
    t = np.arange(len(values)) / RATE
    channel = Channel(t, values, "m/s2", "acceleration", "imu0", RATE)
    write(Recording({"imu0/acceleration": channel}, "made", "made", ""), folder / "log.mcap")
    log = str(folder / "log.mcap")
    assert run("actigraph", log, "-o", str(folder / "out"), "-q").return_value == 0
    calibration, target = str(folder / "out/calibration.yaml"), str(folder / "rests.mcap")
    made = run("apply", calibration, log, "-o", str(folder / "c.mcap"), "--residuals", target)
    assert made.return_value == 0
    return folder


def test_residuals_are_those_of_the_rests(files: Path) -> None:
    expected = (np.linalg.norm(GRAVITY * UPS + BIAS, axis=1) - GRAVITY) / (GRAVITY * 1e-3)
    with (files / "rests.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        rests = [m for *_, m in reader.iter_decoded_messages(topics=["/imu0/rest"])]
    assert len(rests) == len(UPS)
    np.testing.assert_allclose([r.residual_before for r in rests], expected, atol=0.1)
    np.testing.assert_allclose([r.residual_after for r in rests], 0.0, atol=0.1)
    np.testing.assert_allclose([r.duration for r in rests], STILL, atol=0.2)
    sizes = [np.hypot(np.hypot(r.after.x, r.after.y), r.after.z) for r in rests]
    np.testing.assert_allclose(sizes, GRAVITY, atol=1e-3)


def test_rosbags_reads_every_topic(files: Path) -> None:
    """With the definitions in the file alone, the type of the stamp too."""
    store = get_typestore(Stores.EMPTY)
    with (files / "rests.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    for schema in summary.schemas.values():
        store.register(get_types_from_msg(schema.data.decode(), schema.name))
        assert "MSG: builtin_interfaces/Time" in schema.data.decode()
    with AnyReader([files / "rests.mcap"], default_typestore=store) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        read = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()]
    assert len(read) == sum(counts.values())
    assert counts["/imu0/rest"] == len(UPS)


def test_the_layout_plots_what_the_file_has(files: Path) -> None:
    layout = json.loads((files / "rests.foxglove.json").read_text(encoding="utf-8"))
    with (files / "rests.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        first = {c.topic: m for _, c, _, m in reader.iter_decoded_messages()}
    used = layout["layout"]
    assert {used["first"], used["second"]} == set(layout["configById"])
    paths = [p["value"] for c in layout["configById"].values() for p in c["paths"]]
    assert len(paths) == 3
    for path in paths:
        topic, _, field = path.partition(".")
        assert isinstance(getattr(first[topic], field), float)


def test_another_suffix_is_refused() -> None:
    with pytest.raises(UsageError, match="MCAP") as refused:
        residual_files(Path("out/rests.rrd"))
    assert "rests.mcap" in (refused.value.remedy or "")
