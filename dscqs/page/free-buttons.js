/** What a finger or the mouse changes between A and B with: a bar that leaves the picture alone. */

import { button, el, show } from "./dom.js";

/** The bar is there from the start, and again whenever a pointer moves or touches, so long, ms. */
const SEEN_MS = 3000;

/**
 * Put the bar over the picture: {mark, remove}; `mark(what, mayGrade)` says what is shown.
 *
 * @param acts {A, B, grade}: what each button does
 */
export function freeButtons(main, texts, title, acts) {
  const names = texts.freeButtons;
  const sides = ["A", "B"].map((side) =>
    button(side, acts[side], { "aria-label": names[side], "aria-pressed": "false" }));
  const grade = button(names.grade, acts.grade, { class: "main", disabled: true });
  show(main, "free", el("h1", { text: title }), el("div", { class: "bar" }, sides, grade));
  let timer = 0;
  const wake = () => {
    main.dataset.bar = "yes";
    clearTimeout(timer);
    timer = setTimeout(() => {
      main.dataset.bar = "no";
    }, SEEN_MS);
  };
  // a touch wakes when it is over, so that it is no press of what it brings up
  const moved = (event) => event.pointerType !== "touch" && wake();
  main.addEventListener("pointermove", moved);
  main.addEventListener("click", wake);
  wake();
  return {
    mark: (what, mayGrade) => {
      for (const one of sides) one.setAttribute("aria-pressed", String(one.textContent === what));
      grade.disabled = !mayGrade;
    },
    remove: () => {
      clearTimeout(timer);
      delete main.dataset.bar;
      main.removeEventListener("pointermove", moved);
      main.removeEventListener("click", wake);
    },
  };
}
