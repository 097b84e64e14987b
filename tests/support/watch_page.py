"""Pages of the service in a browser."""

from __future__ import annotations

import contextlib
import time

import numpy as np

from tests.support.browser import PATIENCE_MS


@contextlib.contextmanager
def opened(chromium, url, *, width=1280, errors=()):
    """A page that logs no error but those named."""
    context = chromium.new_context(viewport={"width": width, "height": 800})
    context.set_default_timeout(PATIENCE_MS)
    page = context.new_page()
    said = []
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("console", lambda line: said.append(line.text) if line.type == "error" else None)
    page.goto(url)
    yield page
    context.close()
    assert [line for line in said if not any(known in line for known in errors)] == []


def until_page(page, condition):
    """Wait for a condition; the page's policy lets the browser's own waiting not in."""
    deadline = time.monotonic() + PATIENCE_MS / 1000
    while not page.evaluate(condition):
        assert time.monotonic() < deadline, condition
        page.wait_for_timeout(50)


def canvas_pixels(page):
    """Return the canvas of the watch page: (H, W, 3) uint8."""
    data = page.evaluate(
        """() => {
          const { view } = window.depthsrWatch, { gl, canvas } = view;
          view.draw();
          const out = new Uint8Array(4 * canvas.width * canvas.height);
          gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, out);
          return [canvas.width, canvas.height, Array.from(out)];
        }"""
    )
    width, height, flat = data
    return np.array(flat, np.uint8).reshape(height, width, 4)[::-1, :, :3]
