/** What the browser, its window and its screen are like now, and what disturbs a presentation. */

import { hasHeadset } from "./headset.js";

const MEASURED_FRAMES = 40;

/** Follows the size of a canvas in device pixels. */
export class Environment {
  #canvas;
  #size = null;
  #observer;
  #period = null;

  constructor(canvas) {
    this.#canvas = canvas;
    this.#observer = new ResizeObserver(([entry]) => {
      const box = entry.devicePixelContentBoxSize?.[0];
      if (box) this.#size = [box.inlineSize, box.blockSize];
      else this.#size = devicePixelRatio === 1 ? cssSize(canvas) : null;
    });
    try {
      this.#observer.observe(canvas, { box: "device-pixel-content-box" });
    } catch {
      this.#observer.observe(canvas);
    }
    const forget = () => {
      this.#period = null;
    };
    addEventListener("resize", forget);
    document.addEventListener("fullscreenchange", forget);
  }

  /** Return the time from refresh to refresh, ms: measured once for a window. */
  async period() {
    this.#period ??= await refreshPeriod();
    return this.#period;
  }

  /** Return what `refusals` and `warnings` of layout.js ask for. */
  async observe(drawing) {
    await nextFrame();
    await nextFrame();
    return {
      webgl2: drawing !== null,
      largestTexture: drawing?.largestTexture ?? 0,
      canvas: this.#size,
      ratio: devicePixelRatio,
      zoom: visualViewport?.scale ?? 1,
      fullscreen: document.fullscreenElement !== null,
      webxr: await hasHeadset(),
      refreshHz: 1000 / (await this.period()),
    };
  }

  /**
   * Call `report({kind, detail})` for whatever spoils what is shown; returns how to stop.
   *
   * @param needsScreen false in a headset, whose picture does not depend on the window
   */
  watch(report, { needsScreen }) {
    const size = String(this.#size);
    const listeners = [
      [document, "visibilitychange", () =>
        document.hidden && report({ kind: "hidden", detail: "the page was hidden" })],
      [window, "pagehide", () => report({ kind: "left", detail: "the page was left" })],
      [this.#canvas, "webglcontextlost", () =>
        report({ kind: "graphics", detail: "the graphics context was lost" })],
    ];
    if (needsScreen) {
      listeners.push(
        [window, "blur", () => report({ kind: "focus", detail: "the window lost the focus" })],
        [document, "fullscreenchange", () =>
          document.fullscreenElement === null &&
          report({ kind: "fullscreen", detail: "the full screen was left" })],
        [window, "resize", () =>
          requestAnimationFrame(() => String(this.#size) !== size &&
            report({ kind: "resized", detail: `from ${size} to ${this.#size}` }))],
      );
    }
    for (const [target, name, listener] of listeners) target.addEventListener(name, listener);
    return () => {
      for (const [target, name, listener] of listeners) target.removeEventListener(name, listener);
    };
  }
}

/** Return the time from refresh to refresh of the screen: the median of some, ms. */
async function refreshPeriod() {
  const times = [];
  while (times.length < MEASURED_FRAMES) times.push(await nextFrame());
  const gaps = times.slice(1).map((time, index) => time - times[index]);
  gaps.sort((a, b) => a - b);
  return gaps[gaps.length >> 1];
}

function nextFrame() {
  return new Promise((resolve) => {
    requestAnimationFrame(resolve);
  });
}

function cssSize(canvas) {
  return [canvas.clientWidth, canvas.clientHeight];
}
