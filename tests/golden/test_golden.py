"""What is learned stays what it was: the digests of tree, report, notes and certificate of the quick golden cases."""

from __future__ import annotations

import pytest

from .cases import CASES, kept


@pytest.mark.parametrize("key", [key for key, case in CASES.items() if case.quick])
def test_what_is_learned_is_unchanged(key: str) -> None:
    """A wanted change is written down by `python -m tests.golden`, and told in the commit."""
    assert CASES[key].digests() == kept()[key]


def test_every_kept_digest_belongs_to_a_case() -> None:
    assert set(kept()) == set(CASES)
