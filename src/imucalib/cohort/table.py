"""The table of a cohort as CSV or Parquet, whole or not at all."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from imucalib.atomic_file import replaced_atomically
from imucalib.errors import UsageError
from imucalib.recording.pairing import cell


def write_table(rows: tuple[dict[str, Any], ...], path: Path) -> None:
    """Write rows; columns are the union of all rows' keys, in order of first appearance.

    Raises UsageError for a suffix that is neither .csv nor .parquet, or without the extra.
    """
    columns = list(dict.fromkeys(name for row in rows for name in row))
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".parquet":
        _parquet(rows, columns, path)
        return
    if path.suffix != ".csv":
        raise UsageError(f"no table format for '{path.suffix}'", remedy="use .csv or .parquet")
    with replaced_atomically(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writerow({name: cell(name) for name in columns})
        writer.writerows({k: cell(v) for k, v in row.items()} for row in rows)


def _parquet(rows: tuple[dict[str, Any], ...], columns: list[str], path: Path) -> None:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise UsageError(
            "Parquet needs pyarrow", remedy="pip install 'imucalib[parquet]', or write .csv"
        ) from None
    table = pyarrow.table({name: [row.get(name) for row in rows] for name in columns})
    with replaced_atomically(path) as temporary:
        pyarrow.parquet.write_table(table, temporary)
