"""Only failures that may pass by themselves are tried again."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import pytest
from prefect.states import Completed, Failed

from learner.errors import NothingLearnedError
from pipelines.errors import CommandError, UnreachableError
from pipelines.flows.patience import PATIENT
from recorder.errors import DiskError, NotARecordingError
from storage.errors import NotStoredError, StorageUnavailableError

MAY_PASS = [StorageUnavailableError("busy"), UnreachableError("no answer"), DiskError("full")]
WILL_NOT = [
    NothingLearnedError("no tree follows"),
    CommandError("no"),
    NotARecordingError(Path("a.mcap"), "damaged"),
    NotStoredError("tree", "kitting", []),
    ValueError("a defect"),
]


def tried_again(state: Any) -> bool:
    condition = PATIENT["retry_condition_fn"]
    return cast(bool, condition(None, None, state))


@pytest.mark.parametrize("error", MAY_PASS, ids=lambda error: type(error).__name__)
def test_what_may_pass_is_tried_again(error: Exception) -> None:
    assert tried_again(Failed(data=error))


@pytest.mark.parametrize("error", WILL_NOT, ids=lambda error: type(error).__name__)
def test_what_will_not_pass_is_not(error: Exception) -> None:
    assert not tried_again(Failed(data=error))


def test_what_is_done_is_not_done_again() -> None:
    assert not tried_again(Completed(data=1))
