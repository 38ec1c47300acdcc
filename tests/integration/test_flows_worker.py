"""Warm processes: one job after another, and none that fails, dies or hangs takes the next one with it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from support_jobs import die, echo, fail, hang, tell_and_wait

from pipelines.flows.worker import JobFailedError, JobGivenUpError, Worker


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    with Worker("tried") as worker:
        yield worker


def test_the_same_process_does_one_job_after_another(worker: Worker) -> None:
    first, second = worker.do(echo, "a").split(), worker.do(echo, "b").split()
    assert (first[0], second[0]) == ("a", "b")
    assert first[1] == second[1] != str(os.getpid())


def test_news_are_told_while_the_job_goes_on(worker: Worker, tmp_path: Path) -> None:
    file = tmp_path / "heard"
    assert worker.do(tell_and_wait, str(file), news=file.touch) == "done"


def test_what_a_job_raises_comes_back_as_a_sentence_and_the_process_goes_on(worker: Worker) -> None:
    process = worker.do(echo, "a").split()[1]
    with pytest.raises(JobFailedError, match="TakenError: the oven is running already: a cake"):
        worker.do(fail)
    assert worker.do(echo, "b").split()[1] == process


def test_a_process_that_dies_in_a_job_is_told_and_replaced(worker: Worker) -> None:
    with pytest.raises(JobFailedError, match="ended with exit code 7 in the middle"):
        worker.do(die)
    assert worker.do(echo, "a").startswith("a")


def test_a_job_that_became_hopeless_is_ended(worker: Worker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipelines.flows.worker.LOOK_S", 0.05)
    process = int(worker.do(echo, "a").split()[1])
    with pytest.raises(JobGivenUpError):
        worker.do(hang, hopeless=lambda: True)
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
    assert worker.do(echo, "b").startswith("b")
