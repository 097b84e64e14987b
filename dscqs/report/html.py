"""A report as one HTML file: styles and plots (SVG) are inside, nothing is fetched."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable

import jinja2
import matplotlib
from matplotlib.backends.backend_svg import FigureCanvasSVG

from dscqs.report.blocks import Block, Plot


def html(title: str, subtitle: str, blocks: Iterable[Block]) -> bytes:
    """Return the report as UTF-8 HTML.

    Parameters
    ----------
    title, subtitle : str
        Plain text.
    blocks : iterable of Block
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("dscqs.report", "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    parts = [
        {
            "kind": type(block).__name__,
            "block": block,
            "svg": svg(block, f"plot{index}") if isinstance(block, Plot) else "",
        }
        for index, block in enumerate(blocks)
    ]
    template = environment.get_template("report.html")
    return template.render(title=title, subtitle=subtitle, parts=parts).encode()


def svg(plot: Plot, prefix: str) -> str:
    """Return a plot as an SVG element whose ids begin with a prefix of their own."""
    stream = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "path", "svg.hashsalt": prefix}):
        FigureCanvasSVG(plot.draw()).print_svg(
            stream, metadata={"Date": None, "Creator": None, "Format": None, "Type": None}
        )
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r'\bid="', f'id="{prefix}-', text)
    text = re.sub(r'(xlink:href="#|url\(#)', rf"\1{prefix}-", text)
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    # Sizes in points are left to the page; the viewBox keeps the shape.
    return re.sub(r'<svg([^>]*?) height="[^"]*"([^>]*?) width="[^"]*"',
                  r'<svg\1\2 aria-hidden="true"', text, count=1)  # fmt: skip
