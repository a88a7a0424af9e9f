"""Lock step over DDS: who may advance when, so that a replay by processes is the one in a single process.

The player and every node tell, step by step, how many messages they have published on each topic so far
(``NodeProgress``).  A node advances when it has received what was promised to it for the step: of the messages
logged and of the nodes before it those of this step, of topics that close a loop those of the step before.
Messages of later steps wait in their queues.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from fbn_common.records import NodeProgress
from fbn_ros.progress import FIRST_STEP, PLAYER


class Promise(NamedTuple):
    """What a publisher has sent up to a step."""

    stamp_ns: int
    counts: dict[str, int]


class Due(NamedTuple):
    """A step that can be taken: messages by topic, in the order of the topics' declaration."""

    step: int
    stamp_ns: int
    messages: list[tuple[str, list[Any]]]


class Missing(NamedTuple):
    """What a step still waits for."""

    topic: str
    publisher: str
    expected: int | None  # None: not even told yet
    received: int


class StepGate:
    """Holds a subscriber's messages until all of the next step are there.

    ``publishers`` names the node that publishes a topic; the player speaks for the topics it lists.
    """

    def __init__(self, inputs: Sequence[str], feedback: Sequence[str], publishers: Mapping[str, str]) -> None:
        self.step = FIRST_STEP  # the next to be taken
        self._lag = dict.fromkeys(inputs, 0) | dict.fromkeys(feedback, 1)
        self._publishers = publishers
        self._queues: dict[str, deque[Any]] = {t: deque() for t in self._lag}
        self._taken: Counter[str] = Counter()
        heeded = dict.fromkeys((PLAYER, *(publishers[t] for t in self._lag if t in publishers)))
        self._promises: dict[str, dict[int, Promise]] = {name: {} for name in heeded}
        self._played: frozenset[str] = frozenset()
        self._short = 0  # messages that the topic looked at last still lacks
        self._short_topic = ""

    @property
    def heeded(self) -> tuple[str, ...]:
        """Whose progress matters here."""
        return tuple(self._promises)

    def add(self, topic: str, message: Any) -> None:
        """A message has come."""
        self._queues[topic].append(message)
        if topic == self._short_topic:
            self._short -= 1

    def promise(self, progress: NodeProgress) -> None:
        """A publisher has told how many it has sent; who publishes nothing for us is not heeded."""
        if progress.node not in self._promises:
            return
        counts = {c.topic: c.count for c in progress.published}
        self._promises[progress.node][progress.step] = Promise(progress.stamp_ns, counts)
        self._short = 0
        if progress.node == PLAYER:
            self._played = frozenset(counts)

    def due(self) -> Due | None:
        """The next step's messages, if all are there; the step counts as taken."""
        if self._short > 0:  # nothing has changed that could matter
            return None
        player = self._promises[PLAYER].get(self.step)
        lacking = next(iter(self.missing()), None)
        if player is None or lacking is not None:
            self._wait_for(lacking)
            return None
        messages = [(topic, self._take(topic)) for topic in self._lag]
        due = Due(self.step, player.stamp_ns, messages)
        self.step += 1
        for promised in self._promises.values():
            promised.pop(self.step - 2, None)
        return due

    def _wait_for(self, lacking: Missing | None) -> None:
        """Not to look again before this topic's messages, or another promise, have come."""
        if lacking is None or lacking.expected is None:
            self._short, self._short_topic = 1, ""
        else:
            self._short, self._short_topic = lacking.expected - lacking.received, lacking.topic

    def missing(self) -> Iterable[Missing]:
        """What the next step waits for."""
        for topic in self._lag:
            expected, received = self._expected(topic), self._taken[topic] + len(self._queues[topic])
            if expected is None or received < expected:
                yield Missing(topic, self._source(topic), expected, received)

    def _source(self, topic: str) -> str:
        return PLAYER if topic in self._played else self._publishers.get(topic, PLAYER)

    def _expected(self, topic: str) -> int | None:
        step = self.step - self._lag[topic]
        if step < FIRST_STEP:
            return 0
        promise = self._promises[self._source(topic)].get(step)
        return None if promise is None else promise.counts.get(topic, 0)

    def _take(self, topic: str) -> list[Any]:
        count = (self._expected(topic) or 0) - self._taken[topic]
        self._taken[topic] += count
        queue = self._queues[topic]
        return [queue.popleft() for _ in range(count)]
