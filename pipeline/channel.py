"""A bounded queue between two threads that always comes to an end.

The producer waits while the queue is full (the slow side paces the fast one);
its exception reaches the consumer; either side can close, after which the other
never waits again.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Generic, TypeVar

from pipeline.background import give_way

Item = TypeVar("Item")


class ChannelClosedError(Exception):
    """The other side of the channel has gone."""


class Channel(Generic[Item]):
    """A queue of at most ``capacity`` items.

    Parameters
    ----------
    capacity : int
        Items that may wait, ≥ 1.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._items: deque[Item] = deque()
        self._changed = threading.Condition()
        self._finished = False
        self._closed = False
        self._error: BaseException | None = None

    def put(self, item: Item) -> None:
        """Add an item, waiting for room; raise ChannelClosedError if nobody wants it any more."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or len(self._items) < self._capacity)
            if self._closed:
                raise ChannelClosedError
            self._items.append(item)
            self._changed.notify_all()

    def finish(self, error: BaseException | None = None) -> None:
        """Say that no more items come; the error, if any, is raised at the consumer."""
        with self._changed:
            self._finished = True
            self._error = error
            self._changed.notify_all()

    def close(self) -> None:
        """Drop what waits and let nobody wait any more; may be called again."""
        with self._changed:
            self._closed = True
            self._items.clear()
            self._changed.notify_all()

    def take(self) -> Item:
        """Return the next item, waiting for it.

        Raises
        ------
        ChannelClosedError
            If there are no more items; the producer's error instead, if it had one.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._finished or self._items)
            if self._items and not self._closed:
                item = self._items.popleft()
                self._changed.notify_all()
                return item
            if self._error is not None and not self._closed:
                raise self._error
            raise ChannelClosedError

    def __iter__(self) -> Iterator[Item]:
        """Take items until the producer finishes or somebody closes."""
        while True:
            try:
                yield self.take()
            except ChannelClosedError:
                return


class Ahead(Generic[Item]):
    """An iterator over items that a thread of its own takes from their source ahead of time.

    An error of the source is raised here, after the items before it.

    Parameters
    ----------
    items : iterable
        Used by that thread only, which begins at once.
    name : str
        Of the thread.
    capacity : int
        Items that may wait.
    gives_way : bool
        Whether that thread is to run where a core is free: see :mod:`pipeline.background`.
    """

    def __init__(
        self, items: Iterable[Item], *, name: str, capacity: int = 1, gives_way: bool = False
    ) -> None:
        self._items = items
        self._gives_way = gives_way
        self._channel: Channel[Item] = Channel(capacity)
        self._thread = threading.Thread(target=self._fill, name=name)
        self._thread.start()

    def __iter__(self) -> Iterator[Item]:
        return self

    def __next__(self) -> Item:
        try:
            return self._channel.take()
        except ChannelClosedError:
            raise StopIteration from None

    def close(self) -> None:
        """End the thread, waiting for the item that is being made; may be called again."""
        self._channel.close()
        self._thread.join()

    def _fill(self) -> None:
        if self._gives_way:
            give_way()
        try:
            for item in self._items:
                self._channel.put(item)
                del item  # it may be large, and the next one takes its time
        except ChannelClosedError:
            pass
        except BaseException as error:  # it belongs to whoever takes the items
            self._channel.finish(error)
        else:
            self._channel.finish()
