"""A process that has just read the lake ends as it means to, whatever Arrow's threads still do."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pyarrow as pa

from storage.table import Table

SCHEMA = pa.schema([("name", pa.string()), ("number", pa.int64())])
READ_AND_END = """
import sys
from pathlib import Path
import pyarrow as pa
from storage.table import Table

table = Table(Path(sys.argv[1]), pa.schema([("name", pa.string()), ("number", pa.int64())]), ["name"])
for _ in range(3):
    rows = table.read(filters=[("number", ">=", 0)])
sys.exit(7 if rows.num_rows == 24 else 1)
"""


def test_a_process_ends_cleanly_right_after_reading(tmp_path: Path) -> None:
    table = Table(tmp_path / "table", SCHEMA, ["name"])
    for commit in range(8):
        table.append(pa.table({"name": ["a", "b", "c"], "number": [commit] * 3}, SCHEMA), {f"commit-{commit}": 1})
    for _ in range(6):
        done = subprocess.run(
            [sys.executable, "-c", READ_AND_END, str(table.path)], capture_output=True, text=True, timeout=60
        )
        assert (done.returncode, done.stderr) == (7, "")
