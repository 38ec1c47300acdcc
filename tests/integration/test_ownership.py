"""A role on a network has one owner; who comes second is told who that is."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
import zenoh
from support_cell import free_endpoint, session_on

from pipelines.errors import TakenError
from pipelines.network.ownership import owned

KEY = "treewright/c1/run"


@pytest.fixture
def sessions() -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    endpoint = free_endpoint()
    with session_on(endpoint, "listen") as one, session_on(endpoint, "connect") as other:
        yield one, other


def test_the_second_is_refused_by_a_sentence_that_names_the_first(
    sessions: tuple[zenoh.Session, zenoh.Session],
) -> None:
    one, other = sessions
    with owned(one, KEY, "a tree on cell 'c1'") as owner:
        told = f"a tree on cell 'c1' is running already: process {os.getpid()} on"
        with pytest.raises(TakenError, match=told), owned(other, KEY, "a tree on cell 'c1'"):
            pytest.fail("two owners")
        assert str(owner).startswith(f"process {os.getpid()} on {owner.host}, since ")
        with owned(other, "treewright/c2/run", "a tree on cell 'c2'"):
            pass
    with owned(other, KEY, "a tree on cell 'c1'"):
        pass


def test_of_many_that_start_at_the_same_moment_one_wins(sessions: tuple[zenoh.Session, zenoh.Session]) -> None:
    """Who wins stays until all others were refused: on a slow machine somebody looks long after the others."""
    together, done, refused = threading.Barrier(6), threading.Event(), threading.Semaphore(0)
    owners = []

    def compete(number: int) -> bool:
        together.wait()
        try:
            with owned(sessions[number % 2], KEY, "a role") as owner:
                owners.append(owner)
                done.wait(20)
                return True
        except TakenError:
            refused.release()
            return False

    with ThreadPoolExecutor(6) as pool:
        found = [pool.submit(compete, number) for number in range(6)]
        all(refused.acquire(timeout=20) for _ in range(5))
        done.set()
        assert [each.result(30) for each in found].count(True) == 1
    assert len(owners) == 1
