"""The processes that `serve` and `demo` own: they end with their owner, and what went wrong is said."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support_processes import wait_until

from pipelines.service.child import Child, ChildFailedError

STUBBORN = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('{}', flush=True); time.sleep(60)"


def python(script: str, tmp_path: Path, speaks_json: bool = True) -> Child:
    return Child("child", [sys.executable, "-c", script], os.environ, tmp_path / "child.log", speaks_json)


def alive(process_id: int) -> bool:
    """Whether a process runs; one that ended and waits to be collected does not."""
    try:
        return Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_it_says_objects_and_then_its_exit_code(tmp_path: Path) -> None:
    with python("print('{\"a\": 1}')", tmp_path) as child:
        assert child.hear(30) == {"a": 1}
        assert child.wait(30) == 0


def test_one_that_ends_before_it_speaks_is_told_with_its_last_words(tmp_path: Path) -> None:
    with (
        python("import sys; sys.exit('the disk is full')", tmp_path) as child,
        pytest.raises(ChildFailedError, match=r"child ended with exit code 1: the disk is full \(see .*child\.log\)"),
    ):
        child.hear(30)


def test_of_one_that_says_good_bye_the_error_is_told_and_none_of_an_earlier_life(tmp_path: Path) -> None:
    good_bye = "import atexit, sys; atexit.register(lambda: print('Stopped!', file=sys.stderr)); "
    with (
        python(f"{good_bye} raise ValueError('the oven is broken')", tmp_path) as child,
        pytest.raises(ChildFailedError, match=r"exit code 1: ValueError: the oven is broken \(see"),
    ):
        child.hear(30)
    with (
        python(f"{good_bye} sys.exit(2)", tmp_path) as child,
        pytest.raises(ChildFailedError, match=r"exit code 2: Stopped! \(see"),
    ):
        child.hear(30)


def test_one_that_is_silent_is_not_waited_for_forever(tmp_path: Path) -> None:
    with (
        python("import time; time.sleep(60)", tmp_path) as child,
        pytest.raises(ChildFailedError, match="said nothing"),
    ):
        child.hear(0.2)


def test_what_it_started_ends_with_it(tmp_path: Path) -> None:
    script = (
        "import json, subprocess, sys, time\n"
        "grandchild = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])\n"
        "print(json.dumps({'id': grandchild.pid}), flush=True); time.sleep(60)"
    )
    with python(script, tmp_path) as child:
        grandchild = child.hear(30)["id"]
        assert alive(grandchild)
    wait_until(lambda: not alive(grandchild), 10)


def test_one_that_does_not_listen_holds_nobody_up(tmp_path: Path) -> None:
    words = [sys.executable, "-c", "import time; time.sleep(60)"]
    with Child("deaf", words, os.environ, tmp_path / "deaf.log", listens=True) as child:
        heard = [child.tell({"file": "a" * 1000}) for _ in range(200)]
        assert heard[0]
        assert not heard[-1]
        assert not child.tell({"file": "a" * 5000})
    assert not child.tell({"file": "a"})


def test_a_long_log_is_moved_aside_while_the_process_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipelines.service.child.LONG_LOG_BYTES", 100)
    script = "import sys; print('x' * 200, flush=True); sys.stdin.readline(); print('more', flush=True)"
    log = tmp_path / "child.log"
    with Child("child", [sys.executable, "-c", script], os.environ, log, listens=True) as child:
        wait_until(lambda: log.exists() and log.stat().st_size > 200)
        child.shorten_log()
        assert log.read_text() == ""
        child.tell({})
        child.wait(30)
    assert log.read_text() == "more\n"
    assert (tmp_path / "child.log.1").read_text() == "x" * 200 + "\n"


def test_one_that_will_not_end_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipelines.service.child.PATIENCE_S", 0.3)
    begin_s = time.monotonic()
    with python(STUBBORN, tmp_path) as child:
        child.hear(30)
    assert child.code == -signal.SIGKILL
    assert time.monotonic() - begin_s < 30


def test_it_ends_when_its_owner_is_killed(tmp_path: Path) -> None:
    script = (
        "import os, sys, time; from pathlib import Path; from pipelines.service.child import Child\n"
        "sleeper = [sys.executable, '-c', 'import os, time; print(os.getpid(), flush=True); time.sleep(60)']\n"
        f"with Child('sleeper', sleeper, os.environ, Path({str(tmp_path / 'sleeper.log')!r})): time.sleep(60)"
    )
    owner = subprocess.Popen([sys.executable, "-c", script], cwd=Path(__file__).parents[2])
    log = tmp_path / "sleeper.log"
    wait_until(lambda: log.exists() and log.read_text().strip())
    owner.kill()
    owner.wait(30)
    wait_until(lambda: not alive(int(log.read_text())), 10)
