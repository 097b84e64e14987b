"""Tables, as aligned text for a terminal and as Markdown for a page."""

from __future__ import annotations

import csv
import io
import math
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass

NOT_MEASURED = "–"


@dataclass(frozen=True, kw_only=True)
class Table:
    """Cells of text under a head; the first column reads from the left, as do those named."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: tuple[str, ...] = ()
    """Further columns that read from the left; the others are numbers."""

    def reads_from_left(self, column: int) -> bool:
        """Return whether a column (0-based) is text."""
        return column == 0 or self.head[column] in self.left

    def as_text(self) -> str:
        """Return the table with its columns aligned."""
        table = (self.head, *self.rows)
        widths = [max(_width(row[column]) for row in table) for column in range(len(self.head))]
        lines = []
        for row in table:
            cells = []
            for column, cell in enumerate(row):
                space = " " * (widths[column] - _width(cell))
                cells.append(cell + space if self.reads_from_left(column) else space + cell)
            lines.append("  ".join(cells).rstrip())
        return "\n".join(lines)

    def as_markdown(self) -> str:
        """Return the table as Markdown."""
        marks = [
            "---" if self.reads_from_left(column) else "--:" for column in range(len(self.head))
        ]
        return "\n".join(
            "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"
            for row in (self.head, marks, *self.rows)
        )

    def as_csv(self) -> str:
        """Return the table as CSV (RFC 4180)."""
        stream = io.StringIO()
        writer = csv.writer(stream)
        writer.writerow(self.head)
        writer.writerows(self.rows)
        return stream.getvalue()


def number(value: float | None, digits: int = 2) -> str:
    """Return a number with so many decimals; a dash where it is None or NaN."""
    if value is None or math.isnan(value):
        return NOT_MEASURED
    return f"{value:.{digits}f}"


def signed(value: float | None, digits: int = 2) -> str:
    """Return a number with its sign."""
    if value is None or math.isnan(value):
        return NOT_MEASURED
    return f"{round(value, digits) + 0.0:+.{digits}f}"


def size(width_height: Sequence[int]) -> str:
    """Return a size as 512×384."""
    return f"{width_height[0]}×{width_height[1]}"


def _width(text: str) -> int:
    return sum(not unicodedata.combining(letter) for letter in text)
