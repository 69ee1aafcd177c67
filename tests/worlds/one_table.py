"""One table in every format that has names: columns, datasets, fields of JSON and of CDR."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import h5py
import numpy as np
from mcap.writer import Writer
from mcap_ros2._dynamic import serialize_dynamic

from imucalib.arrays import Array

N, RATE = 400, 100.0
Table = Mapping[str, Array]


def written_csv(path: Path, table: Table) -> Path:
    names, columns = ["time", *table], [np.arange(N) / RATE, *table.values()]
    rows = zip(*columns, strict=True)
    lines = [",".join(names), *(",".join(f"{float(v)!r}" for v in row) for row in rows)]
    path.with_suffix(".csv").write_text("\n".join(lines) + "\n")
    return path.with_suffix(".csv")


def written_hdf5(path: Path, table: Table) -> Path:
    with h5py.File(path.with_suffix(".h5"), "w") as file:
        file["time"] = np.arange(N) / RATE
        for name, values in table.items():
            file[name] = values
    return path.with_suffix(".h5")


def _mcap(path: Path, table: Table, schema: tuple[str, str, bytes], encode: Callable) -> Path:
    with path.with_suffix(".mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        name, kind, text = schema
        of = writer.register_schema(name=name, encoding=kind, data=text)
        topic = writer.register_channel("/log", "json" if kind == "jsonschema" else "cdr", of)
        for k in range(N):
            ns = k * round(1e9 / RATE)
            message = {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}}
            message |= {name: float(values[k]) for name, values in table.items()}
            writer.add_message(topic, ns, encode(message), ns)
        writer.finish()
    return path.with_suffix(".mcap")


def written_json(path: Path, table: Table) -> Path:
    return _mcap(path, table, ("Log", "jsonschema", b"{}"), lambda m: json.dumps(m).encode())


def written_cdr(path: Path, table: Table) -> Path:
    table = {name.lower(): values for name, values in table.items()}  # ROS has no capitals
    lines = ["builtin_interfaces/Time stamp", *(f"float64 {name}" for name in table)]
    lines += ["=" * 80, "MSG: builtin_interfaces/Time", "int32 sec", "uint32 nanosec"]
    text = "\n".join(lines) + "\n"
    encode = serialize_dynamic("own_msgs/msg/Log", text)["own_msgs/msg/Log"]
    return _mcap(path, table, ("own_msgs/msg/Log", "ros2msg", text.encode()), encode)


FORMATS = (written_csv, written_hdf5, written_json, written_cdr)
