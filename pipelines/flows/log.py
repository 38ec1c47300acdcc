"""What the processes of the flows tell, a line each on standard error, which is a file in `logs/`."""

from __future__ import annotations

import logging
from typing import Final

LOG: Final = logging.getLogger("treewright.flows")


def begin() -> None:
    """Once a process. Not by the root logger, for that is Prefect's to set up."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    LOG.propagate = False
