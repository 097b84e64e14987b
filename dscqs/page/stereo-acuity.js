/** The test of seeing depth, on the very display: which of three squares is in front? */

import { button, el, show } from "./dom.js";
import { MODES } from "./layout.js";
import { wait } from "./pages.js";
import { freshSeed, pick, randomFrom } from "./random.js";
import { readyDisplay } from "./stage.js";
import { answer, begin, threshold } from "./staircase.js";
import {
  disparityOf, LEVELS, makeStereogram, pictureSize, squareAt, squareOf,
} from "./stereogram.js";
import { fill } from "./texts.js";

const BLACK = [0, 0, 0];
/** Between two pictures nothing is shown, so that no flicker tells the difference, ms. */
const PAUSE_MS = 400;

/** Show the test; resolves with its answers for the server. */
export async function stereoAcuity(context) {
  const { main, texts, profile, stage } = context;
  const words = texts.stereo;
  const levels = LEVELS.map((value) => ({ value, ...disparityOf(value, profile) }));
  const base = {
    pixel_pitch_mm: profile.pixel_pitch_mm,
    distance_heights: profile.distance_heights,
    not_shown: levels.filter((level) => !level.isShown).map((level) => level.value),
  };
  if (stage.drawing === null || !levels.some((level) => level.isShown)) {
    await tell(main, texts, [words.cannot]);
    return { ...base, done: false };
  }
  await tell(main, texts, [words.glasses[profile.glasses], words.intro], texts.begin, () =>
    stage.fill());
  const { state, trials } = await run(context, levels);
  const arcsec = threshold(state);
  const said = [arcsec === null ? words.none : fill(words.result, { result: arcsec })];
  if (base.not_shown.length) said.push(fill(words.left, { levels: base.not_shown.join(", ") }));
  await tell(main, texts, said);
  return { ...base, done: true, threshold_arcsec: arcsec, levels: state.results, trials };
}

function tell(main, texts, paragraphs, label = texts.goOn, act = () => {}) {
  return new Promise((resolve) => {
    const go = async () => {
      await act();
      resolve();
    };
    show(
      main,
      "stereo-acuity",
      el("h1", { text: texts.stereo.title }),
      paragraphs.map((text) => el("p", { text })),
      el("div", { class: "actions" }, button(label, go, { class: "main" })),
    );
  });
}

/** Ask until the staircase ends; what was disturbed is asked again with another picture. */
async function run(context, levels) {
  const { main, texts, profile, stage } = context;
  const random = randomFrom(freshSeed());
  let state = begin(levels);
  let isReady = false;
  const trials = [];
  try {
    while (!state.isOver) {
      if (!isReady) {
        stage.reveal(false);
        await readyDisplay(context, null);
        show(main, "dots", el("h1", { text: texts.stereo.title }));
        stage.reveal(true, { pointer: true });
        isReady = true;
      }
      const front = pick(random, 3);
      const level = state.levels[state.at];
      const seed = freshSeed();
      const { chosen, ms } = await ask(stage, profile, { front, disparity: level.pixels, seed });
      if (stage.isLost) location.reload();
      isReady = chosen !== null;
      if (!isReady) continue;
      trials.push({ arcsec: level.value, front: front + 1, chosen: chosen + 1, seed, ms });
      state = answer(state, chosen === front);
    }
  } finally {
    stage.reveal(false);
  }
  return { state, trials };
}

/** Show one picture; resolves with {chosen, ms}: `chosen` is null where it was disturbed. */
async function ask(stage, profile, picture) {
  const source = stage.drawing.fromPicture(makePicture(profile, picture), { stereo: true });
  await wait(PAUSE_MS);
  const stop = keepDrawing(stage, source);
  const began = performance.now();
  const chosen = await answered(stage, profile);
  stop();
  stage.drawing.draw(null, BLACK);
  stage.drawing.free(source);
  return { chosen, ms: Math.round(performance.now() - began) };
}

/** Return both eyes' squares with the numbers 1, 2, 3 below, at the depth of the screen. */
function makePicture(profile, { front, disparity, seed }) {
  const [width, height] = pictureSize(profile);
  const digits = Math.round(height / 5);
  const canvas = document.createElement("canvas");
  canvas.width = 2 * width;
  canvas.height = height + digits;
  const context = canvas.getContext("2d");
  context.fillStyle = "#000";
  context.fillRect(0, 0, canvas.width, canvas.height);
  const pixels = makeStereogram({ width, height, front, disparity, seed });
  context.putImageData(new ImageData(pixels, 2 * width, height), 0, 0);
  context.fillStyle = "#ccc";
  context.font = `${Math.round(digits * 0.7)}px sans-serif`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (let eye = 0; eye < 2; eye++) {
    for (let index = 0; index < 3; index++) {
      const { left, side } = squareOf(width, height, index);
      context.fillText(String(index + 1), eye * width + left + side / 2, height + digits / 2);
    }
  }
  return canvas;
}

/** Draw now; on displays that show the eyes in turn, at every refresh. Returns how to stop. */
function keepDrawing(stage, source) {
  let isOn = true;
  let turn = 0;
  const draw = () => {
    if (!isOn) return;
    stage.drawing.draw(source, BLACK, turn);
    turn = 1 - turn;
    if (stage.drawing.profile.mode === "frame-sequential") requestAnimationFrame(draw);
  };
  requestAnimationFrame(draw);
  return () => {
    isOn = false;
  };
}

/** Resolve with the square chosen, 0…2: keys 1, 2, 3, or a click on it; null if disturbed. */
function answered({ canvas, environment }, profile) {
  const across = MODES[profile.mode].parts[0];
  return new Promise((resolve) => {
    const finish = (chosen) => {
      removeEventListener("keydown", press);
      canvas.removeEventListener("pointerdown", point);
      unwatch();
      resolve(chosen);
    };
    const press = (event) => {
      const chosen = ["1", "2", "3"].indexOf(event.key);
      if (chosen >= 0) finish(chosen);
    };
    const point = (event) => {
      finish(squareAt(((event.offsetX / canvas.clientWidth) * across) % 1, profile));
    };
    const unwatch = environment.watch(() => finish(null), { needsScreen: true });
    addEventListener("keydown", press);
    canvas.addEventListener("pointerdown", point);
  });
}
