"""What the options of commands may be: converters for argparse, so that a wrong number is wrong usage (exit 2).

Each makes a converter: `type=real(above=0)`. Not a number, `nan` and infinities are refused by all of them.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Final

LONGEST_S: Final = 1e8
"""Three years: no wait is longer, and clocks of the system can still add it up."""


def real(
    above: float | None = None, least: float | None = None, most: float | None = None, unit: str = ""
) -> Callable[[str], float]:
    """A number greater than `above`, at least `least`, and at most `most`."""

    def convert(text: str) -> float:
        try:
            value = float(text) if text.isascii() and "_" not in text else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or not _within(value, above, least, most):
            raise argparse.ArgumentTypeError(f"{text!r} is not a number{_range(above, least, most, unit)}")
        return value

    return convert


def whole(least: int, most: int) -> Callable[[str], int]:
    """A whole number from `least` to `most`."""

    def convert(text: str) -> int:
        digits = text.removeprefix("-")
        if not (digits.isascii() and digits.isdigit() and len(digits) <= 20 and least <= int(text) <= most):
            raise argparse.ArgumentTypeError(f"{text!r:.60} is not a whole number from {least} to {most}")
        return int(text)

    return convert


def seconds(above: float | None = None, least: float | None = None, most: float = LONGEST_S) -> Callable[[str], float]:
    """A length of time [s]."""
    return real(above, least, most, " of seconds")


def add_profile_argument(parser: argparse.ArgumentParser) -> None:
    """The option of commands that go by the profile of a cell (`pipelines.profile`)."""
    parser.add_argument(
        "--profile",
        type=Path,
        metavar="FILE",
        help="what stands in the cell, in YAML (cells/<cell>.yaml below TREEWRIGHT_HOME, where it is there)",
    )


def _within(value: float, above: float | None, least: float | None, most: float | None) -> bool:
    return (above is None or value > above) and (least is None or value >= least) and (most is None or value <= most)


def _range(above: float | None, least: float | None, most: float | None, unit: str) -> str:
    told = [f"above {above:g}"] if above is not None else []
    told += [f"from {least:g}"] if least is not None else []
    told += [f"to {most:g}"] if most is not None else []
    return unit + (" " + " ".join(told) if told else "")


MEGABYTES: Final = real(least=1, most=1 << 20)
SEED: Final = whole(0, 2**63 - 1)
STAMP_NS: Final = whole(0, 2**63 - 1)
SPEED: Final = real(above=0, most=100)
"""A simulated cell's time in units of the wall's."""
LEARNERS: Final = whole(1, 256)
INDEX: Final = whole(0, 10**9)
PORT: Final = whole(0, 65535)
PATIENCE: Final = seconds(above=0)
DURATION: Final = seconds(least=0)
PERIOD: Final = seconds(least=1)
