"""What becomes of each key of a cell: looked up once, then known for every sample."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from recorder.intake.channels import KEPT, MOST, Channels
from recorder.intake.patterns import Patterns
from recorder.notices import Notices
from recorder.wire import ACTION, GRIPPER, NOT_RECORDED, POSES, SIGNALS

MOST_ROUTES: Final = 10_000
"""More keys than these are looked at anew in the next recording."""
NO_CHANNEL: Final = (
    f"a message is not recorded, because its key is not among the first {MOST - KEPT}, and a file holds no more; "
    "leave keys out with --exclude"
)


@dataclass
class Route:
    """What becomes of one key: its topic, and its channels by Zenoh encoding."""

    topic: str
    recorded: bool
    channels: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.action = self.topic == ACTION
        self.poses = self.topic == POSES
        self.early = self.topic in (POSES, GRIPPER)
        """Whether it belongs to the pre-roll."""
        self.essential = self.early or self.action or self.topic.startswith(SIGNALS)


class Routes:
    """The routes of the keys below a prefix. For any threads, except that `channel` and `begin_anew` are for one."""

    def __init__(self, prefix: str, patterns: Patterns, notices: Notices) -> None:
        self._prefix, self._patterns, self._notices = prefix, patterns, notices
        self._routes: dict[str, Route] = {}
        self.channels = Channels()
        """Those of the present recording and of the pre-roll before it."""

    def of(self, key: str) -> Route:
        """The route of a key."""
        return self._routes.get(key) or self._routes.setdefault(key, self._new(key))

    def of_topic(self, topic: str) -> Route:
        """The route of a topic."""
        return self.of(self._prefix + topic[1:])

    def channel(self, route: Route, encoding: str) -> int:
        """The number of a route's channel; 0 when there are too many, which is noted."""
        number = route.channels.get(encoding) or self.channels.number(route.topic, encoding, route.essential)
        if number:
            route.channels[encoding] = number
        else:
            self._notices.add(NO_CHANNEL)
        return number

    def begin_anew(self) -> None:
        """The next recording numbers its channels from 1 on."""
        self.channels = Channels()
        for route in list(self._routes.values()):
            route.channels.clear()
        if len(self._routes) > MOST_ROUTES:
            self._routes.clear()

    def _new(self, key: str) -> Route:
        relative = key.removeprefix(self._prefix)
        topic = f"/{relative}"
        own = relative == key or relative.split("/", 1)[0] in NOT_RECORDED
        told = not own and "@" not in {chunk[:1] for chunk in relative.split("/")}
        return Route(topic, told and self._patterns.admit(topic))
