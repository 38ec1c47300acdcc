"""The earlier path of `pipelines.flows.refresh`, under which it may be deployed."""

from __future__ import annotations

from pipelines.flows.refresh import refresh_flow as story_flow

__all__ = ["story_flow"]
