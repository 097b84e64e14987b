/** Small tests of the eyes on the page: one question after the other until the answer is known. */

import { button, el } from "./dom.js";
import { ACUITIES, DIRECTIONS, drawRing, gapOf } from "./landolt.js";
import { drawDigits, drawPlate, PLATE_COUNT, WRONG_ALLOWED } from "./plates.js";
import { freshSeed, pick, randomFrom } from "./random.js";
import { answer, begin, threshold } from "./staircase.js";

const ARROWS = Object.freeze({
  up: "ArrowUp", right: "ArrowRight", down: "ArrowDown", left: "ArrowLeft",
});

/**
 * Ask for gaps of rings, smaller and smaller; resolves with {decimal, levels}, or null where the
 * display cannot show rings.
 */
export function askRings(place, profile, words) {
  const levels = ACUITIES.map((value) => ({ value, ...gapOf(value, profile) }));
  if (!levels.some((level) => level.isShown)) return Promise.resolve(null);
  const random = randomFrom(freshSeed());
  let state = begin(levels);
  let direction;
  const canvas = el("canvas", { class: "ring", role: "img", "aria-label": words.ringQuestion });
  return ask(place, words.ringQuestion, canvas, (done) => {
    const next = () => {
      if (state.isOver) {
        done({ decimal: threshold(state), levels: state.results });
        return;
      }
      direction = DIRECTIONS[pick(random, DIRECTIONS.length)];
      drawRing(canvas, state.levels[state.at].pixels, direction);
    };
    const take = (chosen) => {
      state = answer(state, chosen === direction);
      next();
    };
    next();
    return [
      ...DIRECTIONS.map((name) => ({
        label: words.directions[name], key: ARROWS[name], act: () => take(name),
      })),
      { label: words.unsure, key: "?", act: () => take(null) },
    ];
  });
}

/** Show the plates of a seed one by one; resolves with {shown, right, result}. */
export function askPlates(place, words, seed = freshSeed()) {
  const digits = drawDigits(seed);
  const canvas = el("canvas", { class: "plate", role: "img", "aria-label": words.plateQuestion });
  let at = 0;
  let right = 0;
  return ask(place, words.plateQuestion, canvas, (done) => {
    const next = () => drawPlate(canvas, at, digits[at], seed + at);
    const take = (digit) => {
      if (digit === digits[at]) right += 1;
      at += 1;
      if (at < PLATE_COUNT) next();
      else {
        const isNormal = PLATE_COUNT - right <= WRONG_ALLOWED;
        done({ shown: PLATE_COUNT, right, result: isNormal ? "normal" : "deficient" });
      }
    };
    next();
    return [
      ...Array.from({ length: 10 }, (_, digit) => ({
        label: String(digit), key: String(digit), act: () => take(digit),
      })),
      { label: words.nothing, key: "?", act: () => take(null) },
    ];
  });
}

/** Put a question with its answers as buttons and keys into a place; resolves with the result. */
function ask(place, question, picture, start) {
  return new Promise((resolve) => {
    const done = (result) => {
      removeEventListener("keydown", press);
      place.replaceChildren();
      resolve(result);
    };
    const answers = start(done);
    const press = (event) => {
      const chosen = answers.find((one) => one.key === event.key);
      if (!chosen || !place.isConnected) return;
      event.preventDefault();
      chosen.act();
    };
    addEventListener("keydown", press);
    place.replaceChildren(
      el(
        "div",
        { class: "question" },
        el("p", { text: question, "aria-live": "polite" }),
        picture,
        el(
          "div",
          { class: "answers" },
          answers.map(({ label, act }) => button(label, act, { class: "quiet" })),
        ),
      ),
    );
    place.scrollIntoView({ block: "center" });
  });
}
