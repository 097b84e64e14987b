"""A report as PDF, A4, in the font that matplotlib brings with it."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path

import matplotlib
from fpdf import FPDF
from fpdf.enums import TableBordersLayout
from fpdf.fonts import FontFace
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dscqs.report.blocks import Block, Heading, Paragraph, Plot, Table

MARGIN_MM = 18.0
DPI = 220

MOST_ROWS = 400
"""Rows of a table that are printed; a longer one says how many it leaves out."""

SOFT = (89, 89, 89)
ACCENT = (0, 114, 178)
WARNING = (163, 60, 0)


class _Document(FPDF):
    """Pages with their number at the foot."""

    def footer(self) -> None:
        """Write the number of the page."""
        self.set_y(-12)
        self.set_font("sans", size=8)
        self.set_text_color(*SOFT)
        self.cell(0, 5, f"{self.page_no()} / {{nb}}", align="R")
        self.set_text_color(0)


def pdf(title: str, subtitle: str, blocks: Iterable[Block]) -> bytes:
    """Return the report as the bytes of a PDF file.

    Parameters
    ----------
    title, subtitle : str
        Plain text.
    blocks : iterable of Block
    """
    document = _Document(format="A4")
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    document.add_font("sans", "", fonts / "DejaVuSans.ttf")
    document.add_font("sans", "B", fonts / "DejaVuSans-Bold.ttf")
    document.set_margin(MARGIN_MM)
    document.set_auto_page_break(auto=True, margin=MARGIN_MM)
    document.set_title(title)
    document.set_lang("en")
    document.add_page()
    document.set_font("sans", "B", 18)
    document.multi_cell(0, 8, title, align="L", new_x="LMARGIN", new_y="NEXT")
    document.set_font("sans", size=9)
    document.set_text_color(*SOFT)
    document.multi_cell(0, 5, subtitle, align="L", new_x="LMARGIN", new_y="NEXT")
    document.set_text_color(0)
    document.ln(3)
    parts = [(block, block.draw() if isinstance(block, Plot) else None) for block in blocks]
    for (block, figure), after in zip(parts, [*parts[1:], None], strict=True):
        if isinstance(block, Heading):
            _heading(document, block, keep_with=after[1] if after else None)
        elif isinstance(block, Paragraph):
            _paragraph(document, block)
        elif isinstance(block, Plot) and figure is not None:
            _plot(document, block, figure)
        elif isinstance(block, Table):
            _table(document, block)
    return bytes(document.output())


def _heading(document: FPDF, block: Heading, keep_with: Figure | None) -> None:
    if document.will_page_break(30 + _height(document, keep_with)):
        document.add_page()
    document.ln(5 if block.level == 1 else 3)
    document.set_font("sans", "B", 13 if block.level == 1 else 10.5)
    document.multi_cell(0, 6.5, block.text, align="L", new_x="LMARGIN", new_y="NEXT")
    if block.level == 1:
        document.set_draw_color(*ACCENT)
        document.set_line_width(0.5)
        y = document.get_y() + 0.5
        document.line(document.l_margin, y, document.w - document.r_margin, y)
    document.ln(3)


def _paragraph(document: FPDF, block: Paragraph) -> None:
    document.set_font("sans", "B" if block.warning else "", 9)
    if block.warning:
        document.set_text_color(*WARNING)
    document.multi_cell(0, 4.7, block.text, align="L", new_x="LMARGIN", new_y="NEXT")
    document.set_text_color(0)
    document.ln(2)


def _height(document: FPDF, figure: Figure | None) -> float:
    """Return the height of a plot on the page [mm]; a line or two of text without one."""
    if figure is None:
        return 15.0
    width, height = figure.get_size_inches()
    return float(document.epw * height / width)


def _plot(document: FPDF, block: Plot, figure: Figure) -> None:
    stream = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(stream, dpi=DPI, format="png")
    stream.seek(0)
    if document.will_page_break(_height(document, figure) + 14):
        document.add_page()
    document.image(stream, w=document.epw, alt_text=block.text)
    document.ln(1)
    _caption(document, block.caption)


def _caption(document: FPDF, text: str) -> None:
    document.set_font("sans", size=8)
    document.set_text_color(*SOFT)
    document.multi_cell(0, 4, text, align="L", new_x="LMARGIN", new_y="NEXT")
    document.set_text_color(0)
    document.ln(2)


def _table(document: FPDF, block: Table) -> None:
    if document.will_page_break(30):
        document.add_page()
    rows = block.rows[:MOST_ROWS]
    left_out = len(block.rows) - len(rows)
    more = f" ({left_out} further rows are in the HTML report)" if left_out else ""
    _caption(document, block.caption + more)
    size = 8 if len(block.head) < 8 else 7 if len(block.head) < 11 else 6.3
    document.set_font("sans", size=size)
    document.set_draw_color(200)
    document.set_line_width(0.15)
    widths = _widths(document, block)
    with document.table(
        borders_layout=TableBordersLayout.HORIZONTAL_LINES,
        col_widths=widths,
        width=sum(widths),
        align="LEFT",
        headings_style=FontFace(emphasis="BOLD"),
        num_heading_rows=2 if block.groups else 1,
        text_align=["LEFT" if at < block.names else "RIGHT" for at in range(len(block.head))],
        line_height=size * 0.56,
        padding=(0.5, 1.0),
    ) as table:
        if block.groups:
            row = table.row()
            for title, span in block.groups:
                row.cell(title, colspan=span, align="CENTER")
        table.row(block.head)
        for number, cells in enumerate(rows):
            style = FontFace(emphasis="BOLD", fill_color=(253, 243, 238))
            table.row(cells, style=style if number in block.marked else None)
    document.ln(4)


def _widths(document: FPDF, block: Table) -> tuple[float, ...]:
    """Return widths of columns [mm] that fit the longest word of each, within the page."""
    wanted = []
    for column, title in enumerate(block.head):
        texts = [title, *(row[column] for row in block.rows[:MOST_ROWS])]
        longest = max(document.get_string_width(text) for text in texts)
        wanted.append(min(longest * 1.15 + 4, document.epw / 2))
    total = sum(wanted)
    scale = min(1.0, document.epw / total)
    return tuple(width * scale for width in wanted)
