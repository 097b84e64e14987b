"""Drives the assessor's page as a person would, and writes down what was on the screen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from playwright.sync_api import Error

from tests.support.browser import PATIENCE_MS

PAGE = "main[data-page='{}']"

MOST_FAILURES = 30
"""Presentations shown too late, from which a page is taken for one that never shows any in time."""

RECORD = """async () => {
  const {StereoDrawing} = await import("/dscqs/pages/drawing.js");
  const draw = StereoDrawing.prototype.draw;
  window.drawn = [];
  StereoDrawing.prototype.draw = function (source, surround, turn) {
    draw.call(this, source, surround, turn);
    if (document.documentElement.dataset.showing !== "yes") return;
    const {width, height} = this.canvas;
    const pixel = new Uint8Array(4);
    const [dx, dy] = source === null ? [0, 0] : source.eye;
    const x = Math.floor((width - dx) / 2) + 2;
    const y = Math.floor((height - dy) / 2) + 2;
    this.gl.readPixels(x, height - 1 - y, 1, 1, this.gl.RGBA, this.gl.UNSIGNED_BYTE, pixel);
    window.drawn.push({at: document.timeline.currentTime, rgb: [...pixel.subarray(0, 3)],
      stereo: source !== null && source.stereo});
  };
}"""
"""Notes the frame's time and a pixel (2, 2) of the left eye's picture at every visible drawing."""


SCREEN = """() => {
  const ask = window.requestAnimationFrame.bind(window), held = [];
  let now = 0, most = Infinity;
  window.requestAnimationFrame = (callback) => window.drawn.length < most
    ? ask(() => callback(now += 1000 / 60)) : held.push(callback);
  window.standStillAfter = (drawings) => {
    most = drawings;
    held.splice(0).forEach(window.requestAnimationFrame);
  };
}"""
"""A screen that is never late, and can be made to stand still after so many drawings."""


@dataclass
class AssessorPage:
    """One tab on the assessor's page."""

    page: Any
    drawn: list[list[dict[str, Any]]] = field(default_factory=list)
    """What was drawn, presentation by presentation, of those that led to a vote."""
    clicked: list[dict[str, float]] = field(default_factory=list)
    """Grades as the page was told them, vote by vote."""
    failures: int = 0

    def open(self, url: str) -> AssessorPage:
        """Open a link, begin behind it, and wait for the page of the session."""
        self.page.goto(url)
        if "#" in url:
            self.wait_for("enter")
            self.page.click("button.main")
            self.page.wait_for_url("**/assessor.html")
        self.record()
        return self

    def record(self) -> None:
        self.page.evaluate(RECORD)

    def take_screen(self) -> None:
        """Let time pass by frames of a screen that are never late, however slow the machine."""
        self.page.evaluate(SCREEN)

    def stand_still_after(self, drawings: float) -> None:
        """Stop the screen that was taken after so many drawings; let it go on where it stands."""
        self.page.evaluate("(drawings) => window.standStillAfter(drawings)", drawings)

    def reload(self) -> None:
        self.page.reload()
        self.record()

    @property
    def name(self) -> str:
        return self.page.locator("#page").get_attribute("data-page") or ""

    def wait_for(self, *names: str) -> str:
        """Wait until one of the pages is there; return which."""
        self.page.wait_for_selector(", ".join(PAGE.format(name) for name in names))
        return self.name

    def wait_until_sent(self) -> None:
        """Wait until the server has answered the last vote."""
        self.page.wait_for_selector("main:not(:has(.scales[inert]))", state="attached")

    def wait_until_drawn(self, count: int) -> None:
        """Wait for that many drawings; by asking, since the page's policy lets no text be run."""
        for _ in range(PATIENCE_MS // 20):
            if self.page.evaluate("window.drawn.length") >= count:
                return
            self.page.wait_for_timeout(20)
        raise AssertionError(f"fewer than {count} drawings; the page is {self.name!r}")

    def press_main(self) -> None:
        """Press the button that leads on, and wait until the page has taken it."""
        self.lead_on(lambda button: button.click())

    def lead_on(self, press: Callable[[Any], None], *, again_ms: int = PATIENCE_MS) -> None:
        """Press the button that leads on in a way of one's own, and wait likewise.

        Where the page has not taken it after so long, it is pressed again.
        """
        button = self.page.wait_for_selector("main button.main:enabled")
        for number in range(PATIENCE_MS // 20):
            try:
                if number % (again_ms // 20) == 0:
                    press(button)
                if button.evaluate("(one) => !one.isConnected || one.disabled"):
                    return
            except Error:  # the page was loaded anew
                self.page.wait_for_load_state()
                self.record()
                return
            self.page.wait_for_timeout(20)
        raise AssertionError(f"the button of the page {self.name!r} leads nowhere")

    def answer_screening(self) -> None:
        self.wait_for("screening")
        for group in ("correction", "acuity", "colour"):
            self.page.locator(f"label:has(input[name={group}])").last.click()

    def fill_screening(self) -> None:
        self.answer_screening()
        self.press_main()

    def leave_out_stereo_acuity(self) -> None:
        """The display's pixels are not known: the page says so and goes on."""
        self.wait_for("stereo-acuity")
        self.press_main()

    def answer_fatigue(self) -> None:
        self.wait_for("fatigue")
        lines = self.page.locator(".lines fieldset")
        for index in range(lines.count()):
            lines.nth(index).locator("label").nth(index % 5).click()

    def fill_fatigue(self) -> None:
        self.answer_fatigue()
        self.press_main()

    def come_to_vote(self) -> None:
        """See the next presentation to its end, however often it has to be shown."""
        while True:
            self.wait_until_sent()
            name = self.wait_for("vote", "failed", "elsewhere", "ready", "pause")
            if name == "vote":
                self.drawn.append(self.page.evaluate("window.drawn.splice(0)"))
                return
            if name == "failed":
                self.failures += 1
                assert self.failures < MOST_FAILURES, "no presentation is ever shown in time"
                self.page.evaluate("window.drawn.splice(0)")
            self.press_main()

    def place_of(self, side: int, value: float) -> tuple[float, float, float]:
        """Return a point of a line where a grade lies, and the grade of that very point."""
        box = self.page.locator(".scale .line").nth(side).bounding_box()
        y = round(box["y"] + box["height"] * (1 - value / 100))
        exact = 100 * (1 - (y - box["y"]) / box["height"])
        return box["x"] + box["width"] / 2, y, round(min(100.0, max(0.0, exact)) + 1e-9, 1)

    def middle_of(self, selector: str) -> tuple[float, float]:
        """Return the point where somebody would touch it."""
        box = self.page.locator(selector).bounding_box()
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def grade(self, side: int, value: float) -> float:
        """Click on a line where a grade lies; return the grade of the very point clicked."""
        x, y, grade = self.place_of(side, value)
        self.page.mouse.click(x, y)
        return grade

    def vote(self, first: float, second: float) -> None:
        """Grade both and submit."""
        self.clicked.append({"A": self.grade(0, first), "B": self.grade(1, second)})
        self.press_main()
