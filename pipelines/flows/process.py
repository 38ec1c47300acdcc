"""The process of the flows that `serve` starts: `python -m pipelines.flows.process ROOT PERIOD_S LEARNERS`.

It says {"ready": true} on standard output when it is warm. On standard input it is told {"file": path} of finished
recordings, and {"begin": true} once a Prefect server that comes up is up or will not be; at its end it ends. What is
asked for in Prefect's pages runs too.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from pathlib import Path
from typing import TextIO

from pipelines.flows import log
from pipelines.flows.deployments import serve_flows
from pipelines.flows.dispatcher import Dispatcher
from pipelines.flows.jobs import NEEDED
from pipelines.flows.worker import preload
from pipelines.home import Home


def main(root: str, period_s: str, learners: str) -> None:
    """Work until standard input ends, or SIGTERM."""
    log.begin()
    say = _own_standard_output()
    home = Home(Path(root))
    preload(NEEDED)
    dispatcher = Dispatcher(home, float(period_s), int(learners))
    dispatcher.warm_up()
    threading.Thread(target=_listen, args=(dispatcher,), name="listen", daemon=True).start()
    threading.Thread(target=dispatcher.run, name="dispatch", daemon=True).start()
    print(json.dumps({"ready": True}), file=say, flush=True)
    try:
        serve_flows(home)
    finally:
        # Without waiting for what is being learned: what was not published is learned again by the next one.
        os._exit(0)


def _own_standard_output() -> TextIO:
    """Standard output, for ourselves alone: what libraries print there, in our children too, goes to the log."""
    ours = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    return ours


def _listen(dispatcher: Dispatcher) -> None:
    for line in sys.stdin:
        told = json.loads(line)
        dispatcher.begin() if "begin" in told else dispatcher.tell(Path(told["file"]))
    # Whoever started us is gone.
    os._exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:])
