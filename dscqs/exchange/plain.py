"""JSON of others, checked step by step: every error names the place and the rule."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, NoReturn

from dscqs.errors import VotesError


def parse_json(text: str, name: str) -> Any:
    """Return the value of a JSON text.

    Raises
    ------
    VotesError
        Naming the line and the character in it; also for NaN and infinity, which JSON lacks.
    """

    def refuse(constant: str) -> NoReturn:
        raise VotesError(f"{constant} is not JSON (a missing vote is null)", path=name)

    try:
        return json.loads(text, parse_constant=refuse)
    except json.JSONDecodeError as error:
        raise VotesError(
            f"is not JSON: {error.msg}, character {error.colno}", path=name, line=error.lineno
        ) from error
    except RecursionError as error:
        raise VotesError("is nested too deeply", path=name) from error


class Place:
    """A value of a JSON document, with the way to it.

    Parameters
    ----------
    value : object
    way : str
        ``scores[3].score``; empty: the document.
    name : str
        File, for messages.
    """

    def __init__(self, value: Any, way: str, name: str) -> None:
        self.value, self.way, self.name = value, way, name

    def fail(self, rule: str) -> NoReturn:
        """Raise an error about this place."""
        raise VotesError(f"{self.way}: {rule}" if self.way else rule, path=self.name)

    def get(self, key: str) -> Place | None:
        """Return the value of a key of an object; None where it is absent or null."""
        if not isinstance(self.value, Mapping):
            self.fail("must be an object")
        found = self.value.get(key)
        return None if found is None else Place(found, f"{self.way}.{key}".lstrip("."), self.name)

    def need(self, key: str) -> Place:
        """Return the value of a key that must be there."""
        found = self.get(key)
        if found is None:
            self.fail(f"has no {key!r}")
        return found

    def items(self) -> list[Place]:
        """Return the items of a list."""
        if not isinstance(self.value, list):
            self.fail("must be a list")
        return [
            Place(item, f"{self.way}[{index}]", self.name) for index, item in enumerate(self.value)
        ]

    def number(self) -> float:
        """Return a finite number."""
        if isinstance(self.value, bool) or not isinstance(self.value, (int, float)):
            self.fail(f"{self.value!r} is not a number")
        if not math.isfinite(self.value):
            self.fail("is not finite")
        return float(self.value)

    def key(self) -> str:
        """Return an identifier, number or text, as text."""
        if isinstance(self.value, bool) or not isinstance(self.value, (int, str)):
            self.fail(f"{self.value!r} is not an identifier")
        text = str(self.value).strip()
        if not text:
            self.fail("is empty")
        return text

    def by_id(self) -> dict[str, Place]:
        """Return the items of a list of objects by their ``id``; refuse one that comes twice."""
        found: dict[str, Place] = {}
        for item in self.items():
            key = item.need("id").key()
            if key in found:
                item.fail(f"id {key} is there twice")
            found[key] = item
        return found
