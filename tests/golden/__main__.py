"""Write the golden digests anew: `python -m tests.golden`. It says which changed, and in what."""

from __future__ import annotations

import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # the experiments make the demonstrations
from golden.cases import CASES, FILE, Case, kept


def main() -> None:
    """Compute every case on two processes, say what differs, and write the file."""
    before = kept() if FILE.exists() else {}
    with ProcessPoolExecutor(2) as pool:
        after = dict(zip(CASES, pool.map(_timed, CASES.values()), strict=True))
    for key, digests in after.items():
        old = before.get(key, {})
        changed = sorted(part for part in {*digests, *old} if digests.get(part) != old.get(part))
        if changed:
            print(f"{key}: {', '.join(changed)}")
    FILE.write_text(json.dumps(after, indent=1, sort_keys=True) + "\n")


def _timed(case: Case) -> dict[str, str]:
    begin = time.perf_counter()
    digests = case.digests()
    print(f"{time.perf_counter() - begin:6.1f} s {case.key}", file=sys.stderr, flush=True)
    return digests


if __name__ == "__main__":
    main()
