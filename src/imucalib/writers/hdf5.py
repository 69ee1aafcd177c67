"""Recordings as HDF5: one group a channel, every dataset with its unit and a checksum.

/<triad>/<quantity>/values (N, k) with attributes units, quantity, triad, sampling_rate, and
/<triad>/<quantity>/time (N,) in s; the file has the attributes format, version, start_ns. The
`units` attribute is the rule of NeXus (manual, "Rules for Storing Data Items").
"""

from __future__ import annotations

from pathlib import Path

from imucalib.recording import Recording

FORMAT, VERSION = "imucal recording", 1
_CHUNK_ROWS = 1 << 14


class Hdf5Writer:
    """Writer of HDF5 files; see `imucalib.writers.Writer`."""

    name = "hdf5"
    suffixes = (".h5", ".hdf5")

    def write(self, recording: Recording, path: Path) -> None:
        """Write all channels; a flipped bit in them is found when they are read."""
        import h5py

        with h5py.File(path, "w") as file:
            file.attrs["format"], file.attrs["version"] = FORMAT, VERSION
            if recording.start_ns is not None:
                file.attrs["start_ns"] = recording.start_ns
            file.attrs["source_path"] = recording.path
            file.attrs["source_sha256"] = recording.sha256
            for name, channel in recording.channels.items():
                group = file.create_group(name)
                rows = max(1, min(_CHUNK_ROWS, channel.t.size))
                values = group.create_dataset(
                    "values",
                    data=channel.values,
                    chunks=(rows, channel.values.shape[1]),
                    fletcher32=True,
                )
                time = group.create_dataset("time", data=channel.t, chunks=(rows,), fletcher32=True)
                time.attrs["units"], values.attrs["units"] = "s", channel.unit
                values.attrs["quantity"] = channel.quantity
                values.attrs["triad"] = channel.triad
                values.attrs["sampling_rate"] = channel.rate


WRITER = Hdf5Writer()
