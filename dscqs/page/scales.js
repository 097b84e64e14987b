/** Two continuous vertical scales side by side, A and B, for each dimension. */

import { button, el } from "./dom.js";
import { fifthOf, gradeAfterKey, gradeAt, MOST } from "./grade.js";

const SIDES = ["A", "B"];

/** One scale without a handle until the first click or key. */
class Scale {
  value = null;

  constructor({ name, labels, unset, onchange }) {
    this.labels = labels;
    this.unset = unset;
    this.onchange = onchange;
    this.element = el(
      "div",
      {
        class: "scale",
        role: "slider",
        tabindex: "0",
        "aria-label": name,
        "aria-orientation": "vertical",
        "aria-valuemin": "0",
        "aria-valuemax": "100",
        "aria-valuenow": "50",
        "aria-valuetext": unset,
        onkeydown: (event) => this.#key(event),
        onpointerdown: (event) => this.#down(event),
        onpointermove: (event) => this.#move(event),
      },
      el("div", { class: "line" }, labels.map(() => el("div", { class: "fifth" }))),
      el("div", { class: "handle", hidden: true }),
    );
  }

  set(value) {
    this.value = value;
    const handle = this.element.lastElementChild;
    handle.hidden = false;
    handle.style.setProperty("--from-top", String(1 - value / MOST));
    this.element.setAttribute("aria-valuenow", String(value));
    this.element.setAttribute("aria-valuetext", this.labels[fifthOf(value)]);
    this.onchange();
  }

  #key(event) {
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    const value = gradeAfterKey(this.value, event.key, event.shiftKey);
    if (value === null) return;
    event.preventDefault();
    this.set(value);
  }

  #down(event) {
    if (event.button !== 0) return;
    this.element.setPointerCapture(event.pointerId);
    this.#point(event);
  }

  #move(event) {
    if (this.element.hasPointerCapture(event.pointerId)) this.#point(event);
  }

  #point(event) {
    const { top, height } = this.element.firstElementChild.getBoundingClientRect();
    this.set(gradeAt(event.clientY, top, height));
  }
}

/**
 * Return {element, grades}: `grades()` is {dimension: {A, B}}, or null while one is missing.
 *
 * @param dimensions names
 * @param words of texts.js
 * @param onchange called after each change
 */
export function makeScales({ dimensions, words, onchange }) {
  const scales = {};
  const groups = dimensions.map((dimension) => {
    const labels = words.labels[dimension] ?? words.labels.quality;
    scales[dimension] = Object.fromEntries(
      SIDES.map((side) => [
        side,
        new Scale({
          name: `${words.dimensions[dimension]}: ${side}`,
          labels,
          unset: words.notGraded,
          onchange,
        }),
      ]),
    );
    const { A, B } = scales[dimension];
    const same = button(words.sameAsA, () => A.value !== null && B.set(A.value), {
      class: "same quiet",
    });
    return el(
      "section",
      {
        class: "dimension",
        "aria-label": words.dimensions[dimension],
        onkeydown: (event) => {
          if (event.key === "=" && A.value !== null) B.set(A.value);
        },
      },
      el("h2", { text: words.dimensions[dimension] }),
      el(
        "div",
        { class: "pair" },
        el(
          "div",
          { class: "labels", "aria-hidden": "true" },
          labels.map((label) => el("span", { text: label })),
        ),
        SIDES.map((side) =>
          el(
            "div",
            { class: "side" },
            el("div", { class: "letter", text: side, "aria-hidden": "true" }),
            scales[dimension][side].element,
          ),
        ),
      ),
      same,
    );
  });
  return {
    element: el("div", { class: "scales" }, groups),
    first: scales[dimensions[0]].A.element,
    grades: () => {
      const found = Object.fromEntries(
        dimensions.map((dimension) => [
          dimension,
          Object.fromEntries(SIDES.map((side) => [side, scales[dimension][side].value])),
        ]),
      );
      const isWhole = Object.values(found).every(({ A, B }) => A !== null && B !== null);
      return isWhole ? found : null;
    },
  };
}
