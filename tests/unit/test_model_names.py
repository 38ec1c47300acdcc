"""Which names the contract admits (CONTRACT, Names)."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from learner.errors import LearnerError, NameRefusedError
from learner.model import check_alias, check_name
from learner.model.names import distinct_identifiers, identifier
from learner.model.tree import IDENTIFIER

KINDS = ["cell", "task", "user", "object", "frame"]
BAD = [
    "",
    " ",
    "a b",
    "a\n",
    "\ta",
    "../a",
    "a/b",
    "a\\b",
    "/etc",
    ".",
    "..",
    ".hidden",
    "-rf",
    "_private",
    "a*",
    "a$b",
    "@v",
    "a@1",
    "a:b",
    "Würfel",
    "кубик",
    "\N{ARABIC-INDIC DIGIT ONE}",
    "a\x00b",
    "a" * 65,
    None,
    7,
    b"cube",
    ["cube"],
]
GOOD = ["A", "7", "marker_61", "cube-1.b", "a..b", "a" * 64, "None", "NONE"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", BAD, ids=repr)
def test_a_bad_name_is_refused_for_every_kind_and_the_sentence_says_the_rule(kind: str, name: object) -> None:
    with pytest.raises(NameRefusedError, match="names begin with a letter or digit") as refusal:
        check_name(kind, name)
    assert str(refusal.value).startswith(f"{kind} name ")
    assert "\n" not in str(refusal.value)
    assert isinstance(refusal.value, LearnerError)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", GOOD)
def test_a_good_name_is_returned_as_it_is(kind: str, name: str) -> None:
    assert check_name(kind, name) == name


@pytest.mark.parametrize(("kind", "name"), [("cell", "artifacts"), ("object", "none")])
def test_reserved_names_are_refused_only_for_their_kind(kind: str, name: str) -> None:
    with pytest.raises(NameRefusedError, match="reserved"):
        check_name(kind, name)
    assert [other for other in KINDS if other != kind and check_name(other, name) != name] == []


@pytest.mark.parametrize("name", ["production", "P", "v2", "canary-1.b"])
def test_an_alias_starts_with_a_letter(name: str) -> None:
    assert check_alias(name) == name


@pytest.mark.parametrize("name", ["7", "2nd", "1.0", *BAD], ids=repr)
def test_what_could_be_a_version_is_no_alias(name: object) -> None:
    with pytest.raises(NameRefusedError, match="alias"):
        check_alias(name)


def test_a_long_bad_name_is_cut_in_the_sentence() -> None:
    with pytest.raises(NameRefusedError) as refusal:
        check_name("task", "x" * 10_000)
    assert len(str(refusal.value)) < 300


@given(st.from_regex(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}", fullmatch=True))
def test_every_name_becomes_an_identifier_of_letters_digits_and_underscores(name: str) -> None:
    found = identifier(check_name("task", name))
    assert len(found) == len(name)
    assert IDENTIFIER.fullmatch(f"T{found}")
    assert identifier(found) == found


def test_names_that_differ_only_in_their_punctuation_get_distinct_identifiers() -> None:
    found = distinct_identifiers(["part.1", "part-1", "part_1", "other"])
    assert len(set(found.values())) == 4
    assert found["other"] == "other"
    assert all(IDENTIFIER.fullmatch(value) for value in found.values())
