"""All golden cases: `python -m tests.golden check` compares them with the digests that are kept, and says which differ
in what (exit code 1 if any does); without `check` it writes the digests anew.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # the experiments make the demonstrations
from golden.cases import CASES, FILE, Case, kept

Digests = Mapping[str, Mapping[str, str]]


def main(arguments: list[str]) -> int:
    """Compute every case on two processes, say what differs, and write the file or judge by it."""
    before = kept() if FILE.exists() else {}
    with ProcessPoolExecutor(2) as pool:
        after = dict(zip(CASES, pool.map(_timed, CASES.values()), strict=True))
    differences = list(_differences(before, after))
    print(*differences, sep="\n", end="\n" if differences else "")
    if arguments == ["check"]:
        return 1 if differences else 0
    FILE.write_text(json.dumps(after, indent=1, sort_keys=True) + "\n")
    return 0


def _differences(before: Digests, after: Digests) -> Iterator[str]:
    for key, digests in after.items():
        old = before.get(key, {})
        if changed := sorted(part for part in {*digests, *old} if digests.get(part) != old.get(part)):
            yield f"{key}: {', '.join(changed)}"


def _timed(case: Case) -> dict[str, str]:
    begin = time.perf_counter()
    digests = case.digests()
    print(f"{time.perf_counter() - begin:6.1f} s {case.key}", file=sys.stderr, flush=True)
    return digests


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
