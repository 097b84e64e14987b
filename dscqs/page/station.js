/** Training and presentations on a station: load, show, grade. */

import { pages, wait } from "./pages.js";
import { el, show } from "./dom.js";
import { load, perform, release } from "./showing.js";
import { readyDisplay } from "./stage.js";
import { fill } from "./texts.js";
import { vote } from "./vote.js";

/** The number of a presentation can be read at least this long, ms. */
const NUMBER_MS = 1200;
const OFTEN = 3;

let lastStage = null;
let failures = 0;

/** Show one presentation and take its grades; resolves with the next state. */
export async function station(context, state) {
  const { api, main, texts, stage } = context;
  const shown = await showOne(context, state);
  if (shown === null) return api.get("state");
  const { presentation } = shown;
  const head = numberOf(texts, state);
  try {
    for (;;) {
      const again = {};
      const lookAgain = new Promise((resolve) => {
        again.press = resolve;
      });
      const result = await Promise.race([
        vote(context, {
          ticket: presentation.ticket,
          dimensions: presentation.dimensions,
          head,
          remindAfterS: presentation.timing.vote_s,
          lookAgain: presentation.variant === "I" ? again.press : null,
        }),
        lookAgain.then(() => null),
      ]);
      if (result !== null) return result;
      api.note("looked-again", {});
      await readyDisplay({ api, main, texts, stage }, null);
      await perform(context, shown, head);
    }
  } finally {
    release(shown);
  }
}

/** Load and show; resolves with what was shown, or null where it failed and comes again. */
export async function showOne(context, state) {
  const { api, main, texts, stage } = context;
  const mustAsk = stage.isHeadset || lastStage !== state.stage;
  const said = {
    title: numberOf(texts, state),
    text: stage.isHeadset ? texts.headsetHint : texts.readyHint,
    ...(state.variant === "I" && { keys: texts.freeKeys, hint: texts.freeHint }),
  };
  lastStage = state.stage;
  if (!stage.isHeadset) {
    await readyDisplay(context, mustAsk ? said : null);
  }
  show(main, "loading", el("h1", { text: numberOf(texts, state) }), el("p", { text: texts.loading }));
  const [loaded] = await Promise.all([load(context), wait(NUMBER_MS)]);
  if (stage.isHeadset) await readyDisplay(context, said);
  let isKept = false;
  try {
    const log = await perform(context, loaded, numberOf(texts, state));
    const isGood = log.faults.length === 0;
    await api.post("shown", {
      ticket: loaded.presentation.ticket,
      outcome: isGood ? "ok" : "failed",
      log,
    });
    isKept = isGood;
    failures = isGood ? 0 : failures + 1;
  } finally {
    if (!isKept) release(loaded);
  }
  if (isKept) return loaded;
  await pages.failed(main, texts, failures >= OFTEN);
  if (stage.isLost) location.reload();
  return null;
}

export function numberOf(texts, { stage, index, total }) {
  const text = stage === "training" ? texts.trainingNumber : texts.presentation;
  return fill(text, { index: index + 1, total });
}
