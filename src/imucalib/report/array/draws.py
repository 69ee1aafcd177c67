"""The posterior's draws as a file for other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imucalib.atomic_file import replaced_atomically
from imucalib.calibrators.array.run import ArrayRun


def write_draws(run: ArrayRun, path: Path) -> None:
    """Draws as HDF5 in the layout of ArviZ's netCDF files: /posterior/position_mm with the
    dimensions chain, draw, imu, axis as netCDF4 dimension scales."""
    import h5py

    draws = 1e3 * run.final.draws
    c, n, a, _ = draws.shape
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced_atomically(path) as temporary, h5py.File(temporary, "w") as file:
        group = file.create_group("posterior")
        made = run.outcome.provenance
        group.attrs["inference_library"] = "imucalib"
        group.attrs["inference_library_version"] = made.versions["imucalib"]
        group.attrs["created_at"] = made.time
        text = h5py.string_dtype()
        scales = {
            "chain": np.arange(c),
            "draw": np.arange(n),
            "imu": np.array(run.board.imus, dtype=object),
            "axis": np.array(list("xyz"), dtype=object),
        }
        data = group.create_dataset("position_mm", data=draws, compression="gzip", shuffle=True)
        data.attrs["units"] = "mm"
        for k, (name, values) in enumerate(scales.items()):
            kind = text if values.dtype == object else np.int64
            scale = group.create_dataset(name, data=values, dtype=kind)
            scale.make_scale(name)
            data.dims[k].attach_scale(scale)
        assert data.shape[2] == a
