/** The canvas that pictures are shown on, and whether it can show them as they are. */

import { button, el, show } from "./dom.js";
import { StereoDrawing } from "./drawing.js";
import { Environment } from "./environment.js";
import { Headset } from "./headset.js";
import { refusals, warnings } from "./layout.js";
import { canvasScreen, headsetScreen } from "./player.js";
import { fill } from "./texts.js";

export class Stage {
  #headset = null;
  #wakeLock = null;

  constructor(canvas, profile) {
    this.canvas = canvas;
    this.profile = profile;
    this.environment = new Environment(canvas);
    try {
      this.drawing = new StereoDrawing(canvas, profile);
    } catch {
      this.drawing = null;
    }
  }

  get isHeadset() {
    return this.profile.mode === "webxr";
  }

  /** True where the graphics were lost: only a new page gets them back. */
  get isLost() {
    return this.drawing?.gl.isContextLost() ?? false;
  }

  /** Show the canvas over the page, or the page again; with the pointer where one is asked for. */
  reveal(isVisible, { pointer = false } = {}) {
    const { dataset } = document.documentElement;
    dataset.showing = isVisible ? "yes" : "no";
    dataset.pointer = pointer ? "yes" : "no";
  }

  /** Go to full screen; call from a click or key. What fails shows up in `reasons`. */
  async fill() {
    try {
      if (document.fullscreenElement === null) {
        await document.documentElement.requestFullscreen({ navigationUI: "hide" });
      }
      this.#wakeLock ??= await navigator.wakeLock?.request("screen");
    } catch {
      this.#wakeLock = null;
    }
  }

  /** Return {refused, warned}: lists of reasons. */
  async reasons() {
    const seen = await this.environment.observe(this.drawing);
    return { refused: refusals(this.profile, seen), warned: warnings(this.profile, seen) };
  }

  /** Return what the player draws on; a headset begins here, from a click or key. */
  async open() {
    if (!this.isHeadset) return canvasScreen(this.drawing);
    this.#headset = new Headset(this.drawing);
    await this.#headset.begin(() => {
      this.#headset = null;
    });
    return headsetScreen(this.#headset);
  }

  async close() {
    await this.#headset?.end();
  }
}

/** Return a list of reasons in words. */
export function reasonList(reasons, words) {
  return el(
    "ul",
    { class: "reasons" },
    reasons.map(({ code, values }) => el("li", { text: fill(words.reasons[code], values) })),
  );
}

/**
 * Make sure that the display shows pixels as they are: asks for full screen, and says what is
 * wrong until it is right. `ask` is {title, text, keys, hint}: where given, a button is pressed
 * first; `keys` are [key, what it does].
 */
export async function readyDisplay({ api, main, texts, stage }, ask) {
  const words = texts.display;
  let mustAsk = ask !== null;
  for (;;) {
    if (mustAsk || (!stage.isHeadset && document.fullscreenElement === null)) {
      const { title, text, keys, hint } = ask ?? { title: texts.ready, text: texts.readyHint };
      const said = [el("h1", { text: title }), el("p", { text }), keys && keyList(keys),
        hint && el("p", { text: hint })];
      await pressed(main, "ready", said, texts.start, stage);
    }
    const { refused, warned } = await stage.reasons();
    const codes = (refused.length ? refused : warned).map((reason) => reason.code);
    if (codes.length && (refused.length || ask)) api.note("display", { codes });
    if (refused.length === 0) return;
    await pressed(
      main,
      "display",
      [el("h1", { text: words.title }), el("p", { text: words.cannot }), reasonList(refused, words)],
      words.retry,
      stage,
    );
    mustAsk = false;
  }
}

function keyList(keys) {
  return el("dl", { class: "keys" }, keys.flatMap(([key, what]) => [
    el("dt", { text: key }), el("dd", { text: what })]));
}

function pressed(main, name, content, label, stage) {
  return new Promise((resolve) => {
    const go = button(
      label,
      async () => {
        if (!stage.isHeadset) await stage.fill();
        resolve();
      },
      { class: "main" },
    );
    show(main, name, content, el("div", { class: "actions" }, go));
    go.focus();
  });
}
