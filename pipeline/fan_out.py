"""One stream of items for several takers at once, the slowest of which paces all."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TypeVar

from pipeline.background import give_way
from pipeline.channel import Channel, ChannelClosedError

Item = TypeVar("Item")
Result = TypeVar("Result")


def fan_out(
    items: Iterable[Item],
    takers: Mapping[str, Callable[[Iterator[Item]], Result]],
    *,
    give_way_to_others: bool = False,
) -> dict[str, Result]:
    """Give every item to every taker, each in a thread of its own; return what they return.

    A taker must take all items. Where the items end in an error, or another taker fails, the
    iterator of a taker raises ``ChannelClosedError``, so that nobody mistakes that for the end.

    Parameters
    ----------
    items : iterable
        Used by the calling thread only.
    takers : mapping of names to callables
        Each gets an iterator over the items.
    give_way_to_others : bool
        Whether their threads are to run where a core is free: see :mod:`pipeline.background`.

    Raises
    ------
    Exception
        What the items or the first taker that failed raised.

    Examples
    --------
    >>> fan_out([1, 2, 3], {"sum": sum, "largest": max})
    {'sum': 6, 'largest': 3}
    """
    channels: dict[str, Channel[Item]] = {name: Channel(1) for name in takers}
    complete = threading.Event()
    failures: list[BaseException] = []
    results: dict[str, Result] = {}

    def taken(channel: Channel[Item]) -> Iterator[Item]:
        while True:
            try:
                item = channel.take()
            except ChannelClosedError:
                if complete.is_set():
                    return
                raise
            yield item

    def run(name: str) -> None:
        if give_way_to_others:
            give_way()
        try:
            results[name] = takers[name](taken(channels[name]))
        except ChannelClosedError:
            pass
        except BaseException as error:  # raised again by the caller's thread
            failures.append(error)
            for channel in channels.values():
                channel.close()
        finally:
            channels[name].close()

    threads = [
        threading.Thread(target=run, args=(name,), name=f"depthsr-take-{name}") for name in takers
    ]
    for thread in threads:
        thread.start()
    try:
        for item in items:
            for channel in channels.values():
                channel.put(item)
        complete.set()
    except ChannelClosedError:
        if not failures:
            raise
    finally:
        for channel in channels.values():
            channel.finish() if complete.is_set() else channel.close()
        for thread in threads:
            thread.join()
    if failures:
        raise failures[0]
    return {name: results[name] for name in takers}
