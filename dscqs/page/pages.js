/** The simple pages of a session. */

import { button, el, show } from "./dom.js";
import { fill } from "./texts.js";

const POLL_MS = 2000;

/** Resolve with the state once it is another stage. */
export async function waitForChange(api, state) {
  for (;;) {
    await wait(POLL_MS);
    const now = await api.get("state");
    if (now.stage !== state.stage) return now;
  }
}

export function wait(ms) {
  return new Promise((resolve) => {
    setTimeout(resolve, ms);
  });
}

export const pages = {
  /** A page of a head and a text until a promise resolves. */
  still(main, { title, text }, until) {
    show(main, "still", el("h1", { text: title }), el("p", { text }));
    return until;
  },

  /** The last page: resolves with null. */
  async end(main, name, { title, text }) {
    if (document.fullscreenElement) await document.exitFullscreen();
    show(main, name, el("h1", { text: title }), el("p", { text }));
    return null;
  },

  /** A break: the time runs, and the assessor goes on when it is over. */
  async pause({ api, main, texts }, state) {
    const words = texts.pause;
    const time = el("p", { class: "time", role: "timer" });
    const pressed = new Promise((resolve) => {
      show(
        main,
        "pause",
        el("h1", { text: words.title }),
        el("p", { text: words.text }),
        time,
        el("div", { class: "actions" },
          button(texts.goOn, resolve, { class: "main", disabled: true })),
      );
    });
    const end = performance.now() + 1000 * state.break_s;
    for (let left = end - performance.now(); left > 0; left = end - performance.now()) {
      time.textContent = fill(words.rest, { seconds: Math.ceil(left / 1000) });
      await wait(Math.min(left, 250));
    }
    time.textContent = "";
    main.querySelector("button").disabled = false;
    await pressed;
    return api.post("continue", { stage: state.stage });
  },

  /** The session was opened in another tab; resolves when it is wanted here. */
  elsewhere(main, texts) {
    return ask(main, "elsewhere", texts.elsewhere, texts.elsewhere.here);
  },

  /** A showing that failed; resolves when the assessor is ready for it again. */
  failed(main, texts, isOften) {
    return ask(
      main,
      "failed",
      { title: texts.failedTitle, text: isOften ? texts.failedOften : texts.failed },
      texts.goOn,
    );
  },

  /** Something that must not happen; a reload resumes at the right place. */
  broken(main, texts, error) {
    show(
      main,
      "broken",
      el("h1", { text: texts.tryAgain }),
      el("p", { text: fill(texts.broken, { message: error?.message ?? error }) }),
      el("div", { class: "actions" },
        button(texts.tryAgain, () => location.reload(), { class: "main" })),
    );
  },
};

/** A head, a text and one button; resolves when it is pressed. */
export function ask(main, name, { title, text }, label) {
  return new Promise((resolve) => {
    const go = button(label, resolve, { class: "main" });
    show(main, name, el("h1", { text: title }), el("p", { text }),
      el("div", { class: "actions" }, go));
    go.focus();
  });
}
