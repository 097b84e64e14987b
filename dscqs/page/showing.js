/** One presentation from its fetching to its log. */

import { ApiError } from "./api.js";
import { stimulusRefusals } from "./layout.js";
import { makeLetters } from "./letters.js";
import { play } from "./player.js";
import { freeViewing } from "./free-viewing.js";
import { makeSide } from "./stimulus.js";

/** A presentation that is loaded: {presentation, log, sides}; `log` only where loading failed. */
export async function load({ api, stage }) {
  const presentation = await api.get("presentation");
  const loaded = { presentation, sides: {}, log: null };
  try {
    const entries = await Promise.all(
      Object.entries(presentation.sides).map(async ([name, url]) => {
        const side = await makeSide(stage.drawing, await api.bytes(url));
        return [name, side];
      }),
    );
    loaded.sides = Object.fromEntries(entries);
    const { eye } = loaded.sides.A;
    const [reason] = stimulusRefusals(stage.profile, eye, stage.drawing.largestTexture);
    if (reason) loaded.log = failedLog("display", `${reason.code} ${JSON.stringify(reason.values)}`);
  } catch (error) {
    if (error instanceof ApiError && error.status === 410) throw error;
    const kind = error instanceof ApiError ? "bytes" : "decode";
    loaded.log = failedLog(kind, error.message);
  }
  return loaded;
}

/** Show a loaded presentation, whose number is `title`; resolves with its log. */
export async function perform({ main, stage, texts }, { presentation, sides, log }, title) {
  if (log !== null) return log;
  const letters = makeLetters(stage.drawing, presentation.grey);
  const surround = [presentation.grey, presentation.grey, presentation.grey];
  const screen = await stage.open();
  const sources = [...Object.values(letters), sides.A.current, sides.B.current];
  stage.drawing.warmUp(sources, surround);
  stage.reveal(true);
  try {
    const asked = { presentation, sides, letters, screen, environment: stage.environment };
    return await (presentation.variant === "I" ? freeViewing({ ...asked, main, texts, title }) : play(asked));
  } finally {
    stage.reveal(false);
    await stage.close();
    for (const letter of Object.values(letters)) stage.drawing.free(letter);
  }
}

/** Give the memory of a presentation back. */
export function release({ sides }) {
  for (const side of Object.values(sides)) side.free();
}

function failedLog(kind, detail) {
  return {
    began: new Date().toISOString(),
    refresh_hz: null,
    pixels: {},
    intervals: [],
    faults: [{ kind, at_ms: 0, detail: String(detail).slice(0, 500) }],
  };
}
