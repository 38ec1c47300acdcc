"""A job is done in a flow where it may, and once more without one where Prefect, and nothing of ours, has failed."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from learner.errors import NothingLearnedError
from pipelines.errors import UnreachableError
from pipelines.flows.jobs import in_flow_or_without
from storage.errors import StorageUnavailableError


def failing(error: Exception) -> Callable[[], str]:
    def flow() -> str:
        raise error

    return flow


def test_a_flow_is_run_where_it_may_and_not_where_it_may_not() -> None:
    assert in_flow_or_without(lambda: "flow", failing(AssertionError("done twice")), in_flow=True) == "flow"
    assert in_flow_or_without(failing(AssertionError("a flow")), lambda: "plain", in_flow=False) == "plain"


@pytest.mark.parametrize("error", [RuntimeError("Failed to reach API"), ConnectionRefusedError("no server")])
def test_what_fails_in_prefect_is_done_without_it(error: Exception) -> None:
    assert in_flow_or_without(failing(error), lambda: "plain", in_flow=True) == "plain"


@pytest.mark.parametrize(
    "error", [NothingLearnedError("no tree"), UnreachableError("no answer"), StorageUnavailableError("busy")]
)
def test_what_our_own_parts_refuse_is_not_done_twice(error: Exception) -> None:
    with pytest.raises(type(error)):
        in_flow_or_without(failing(error), failing(AssertionError("done twice")), in_flow=True)


def test_a_defect_of_ours_is_raised_in_the_end() -> None:
    with pytest.raises(ValueError, match="ours"):
        in_flow_or_without(failing(ValueError("ours")), failing(ValueError("ours")), in_flow=True)
