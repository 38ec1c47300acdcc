"""Which failures are tried again: only those that may pass by themselves."""

from __future__ import annotations

from typing import Any, Final

from prefect import Task
from prefect.client.schemas.objects import State, TaskRun

from pipelines.errors import UnreachableError
from recorder.errors import DiskError
from storage.errors import StorageUnavailableError

MAY_PASS: Final = (StorageUnavailableError, UnreachableError, DiskError)


def may_pass(_: Task[..., Any], __: TaskRun, state: State[Any]) -> bool:
    """Whether a task that ended in `state` is worth another try: a full disk is, a refused recording is not."""
    error = state.result(raise_on_failure=False)
    return isinstance(error, MAY_PASS)


PATIENT: Final[dict[str, Any]] = {"retries": 3, "retry_delay_seconds": [1, 5, 15], "retry_condition_fn": may_pass}
"""What every task that touches disk or network is declared with."""
