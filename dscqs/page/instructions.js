/** What the assessor reads first, with lines to try. */

import { button, el, show } from "./dom.js";
import { makeScales } from "./scales.js";
import { fill } from "./texts.js";

/** Show the instructions; resolves with the next state. */
export function instructions({ api, main, texts, stage }, state) {
  const words = texts.instructions;
  const { once, twice, often } = words.shown;
  const shown = { 1: once, 2: twice }[state.showings] ?? fill(often, { times: state.showings });
  const steps = state.variant === "I" ? words.stepsFree : [shown, ...words.steps];
  const { element } = makeScales({
    dimensions: state.dimensions.slice(0, 1),
    words: texts,
    onchange: () => {},
  });
  return new Promise((resolve, reject) => {
    const go = async () => {
      if (stage && !stage.isHeadset) await stage.fill();
      api.post("continue", { stage: state.stage }).then(resolve, reject);
    };
    show(
      main,
      "instructions",
      el(
        "div",
        { class: "columns" },
        el(
          "div",
          {},
          el("h1", { text: words.title }),
          el("p", { text: words.intro }),
          el("ol", {}, steps.map((text) => el("li", { text }))),
          el("div", { class: "actions" }, button(texts.goOn, go, { class: "main" })),
        ),
        el("aside", {}, el("p", { class: "hint", text: words.try }), element),
      ),
    );
  });
}
