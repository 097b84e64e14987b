/** The forms of a session: screening of the eyes, and how they feel before and after. */

import { button, choices, el, show } from "./dom.js";
import { askPlates, askRings } from "./questions.js";
import { fill } from "./texts.js";

const CORRECTIONS = ["none", "glasses", "lenses"];
const ITEMS = ["tired", "sore", "blurred", "double", "headache", "dizzy"];

/** Show the screening form; resolves with its answers. */
export function screening(main, texts, profile) {
  const words = texts.screening;
  return new Promise((resolve) => {
    const answers = { correction: null, acuity: null, colour: null };
    const send = button(texts.goOn, () => resolve(answers), { class: "main", disabled: true });
    const change = (name, value) => {
      answers[name] = value;
      send.disabled = Object.values(answers).includes(null);
    };
    show(
      main,
      "screening",
      el("h1", { text: words.title }),
      el("p", { text: words.intro }),
      choices({
        name: "correction",
        legend: words.correction,
        options: CORRECTIONS.map((name) => [name, words.corrections[name]]),
        onchange: (value) => change("correction", value),
      }),
      part({
        name: "acuity",
        legend: words.acuity,
        words,
        change,
        entry: (set) => decimalEntry(words, set),
        test: async (place) => {
          const found = await askRings(place, profile, words);
          if (found === null) return { said: words.notHere, value: null };
          const said = fill(words.done, { result: found.decimal ?? `< ${found.levels[0].value}` });
          return { said, value: { by: "rings", ...found } };
        },
      }),
      part({
        name: "colour",
        legend: words.colour,
        words,
        change,
        entry: (set) => colourEntry(words, set),
        test: async (place) => {
          const found = await askPlates(place, words);
          const said = fill(words.done, { result: words.colourResults[found.result] });
          return { said, value: { by: "plates", ...found } };
        },
      }),
      el("div", { class: "actions" }, send),
    );
  });
}

/** One quality of the eyes: entered by the operator, tested here, or left out. */
function part({ name, legend, words, change, entry, test }) {
  const place = el("div", { class: "place" });
  const choose = async (way) => {
    change(name, null);
    place.replaceChildren();
    if (way === "skip") change(name, { by: "nobody" });
    else if (way === "operator") {
      place.append(entry((value) => change(name, value && { by: "operator", ...value })));
    } else {
      const inner = el("div");
      place.append(inner);
      const { said, value } = await test(inner);
      if (!inner.isConnected) return;
      place.replaceChildren(el("p", { class: "done", text: said, role: "status" }));
      change(name, value);
    }
  };
  return el(
    "div",
    { class: "part" },
    choices({
      name,
      legend,
      options: [
        ["operator", words.byOperator],
        ["here", words.here],
        ["skip", words.skip],
      ],
      onchange: choose,
    }),
    place,
  );
}

function decimalEntry(words, set) {
  return el(
    "label",
    { class: "entry" },
    el("span", { text: words.decimal }),
    el("input", {
      type: "number", min: "0.05", max: "3", step: "0.01", inputmode: "decimal",
      oninput: (event) => {
        const { valueAsNumber: decimal, validity } = event.target;
        set(validity.valid && decimal > 0 ? { decimal } : null);
      },
    }),
  );
}

function colourEntry(words, set) {
  return choices({
    name: "colour-result",
    legend: words.colourResult,
    options: Object.entries(words.colourResults),
    onchange: (result) => set({ result }),
  });
}

/** Show the questions about fatigue; resolves with {item: 0…4}. */
export function fatigue(main, texts, isAfter) {
  const words = texts.fatigue;
  return new Promise((resolve) => {
    const answers = {};
    const said = el("p", { class: "hint", role: "status" });
    const send = button(
      texts.goOn,
      () => {
        if (Object.keys(answers).length < ITEMS.length) said.textContent = words.missing;
        else resolve(answers);
      },
      { class: "main" },
    );
    show(
      main,
      "fatigue",
      el("h1", { text: isAfter ? words.titleAfter : words.titleBefore }),
      el(
        "div",
        { class: "lines" },
        ITEMS.map((item) =>
          choices({
            name: item,
            legend: words.items[item],
            options: words.degrees.map((degree, index) => [String(index), degree]),
            onchange: (value) => {
              answers[item] = Number(value);
            },
          }),
        ),
      ),
      said,
      el("div", { class: "actions" }, send),
    );
  });
}
