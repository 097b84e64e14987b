/** The assessor's page: asks the server where the session stands, and does what that stage needs. */

import { Api, ApiError } from "./api.js";
import { el, show } from "./dom.js";
import { pages, waitForChange } from "./pages.js";
import { fatigue, screening } from "./forms.js";
import { groupScreen } from "./group-screen.js";
import { instructions } from "./instructions.js";
import { phone } from "./phone.js";
import { Stage } from "./stage.js";
import { station } from "./station.js";
import { stereoAcuity } from "./stereo-acuity.js";
import { browserLanguage, textsOf } from "./texts.js";
import { mirror } from "./twin.js";
import { sendPending } from "./vote.js";

const main = document.getElementById("page");
const banner = document.getElementById("banner");

let texts = await textsOf(browserLanguage());
document.documentElement.lang = browserLanguage();
const api = new Api((isInTrouble) => {
  banner.textContent = isInTrouble ? texts.trouble : "";
});

/** What each stage needs; each resolves with the next state. */
function stagesOf(context) {
  const form = (ask) => async (state) =>
    api.post("forms", { stage: state.stage, answers: await ask() });
  const shown = { station, screen: groupScreen, phone }[context.role];
  return {
    instructions: (state) => instructions(context, state),
    screening: form(() => screening(main, texts, context.profile)),
    stereo_acuity: form(() => stereoAcuity(context)),
    fatigue_before: form(() => fatigue(main, texts, false)),
    fatigue_after: form(() => fatigue(main, texts, true)),
    training: (state) => shown(context, state),
    presentation: (state) => shown(context, state),
    break: (state) => pages.pause(context, state),
    paused: (state) => pages.still(main, texts.paused, waitForChange(api, state)),
    withdrawn: () => pages.end(main, "withdrawn", texts.withdrawn),
    thanks: () => pages.end(main, "thanks", texts.thanks),
  };
}

async function run() {
  const first = await api.get("state");
  texts = await textsOf(first.language);
  document.documentElement.lang = first.language;
  document.title = texts.title;
  await sendPending(api);
  const profile = await api.get("display");
  const context = { api, main, texts, profile, role: first.role, stage: null };
  if (first.role !== "phone") {
    context.stage = new Stage(document.getElementById("display"), profile);
    mirror(main, profile);
  }
  const stages = stagesOf(context);
  let state = await api.get("state");
  while (state !== null) {
    try {
      state = await stages[state.stage](state);
    } catch (error) {
      context.stage?.reveal(false);
      if (!(error instanceof ApiError) || ![409, 410].includes(error.status)) throw error;
      const present = await api.get("state");
      if (present.stage === state.stage && present.index === state.index) {
        await pages.elsewhere(main, texts);
      }
      state = await api.get("state");
    }
  }
}

try {
  await run();
} catch (error) {
  if (error instanceof ApiError && error.status === 401) {
    show(main, "no-session", el("h1", { text: texts.noSession.title }),
      el("p", { text: texts.noSession.text }));
  } else {
    api.note("broken", { message: String(error?.message ?? error).slice(0, 500) });
    pages.broken(main, texts, error);
  }
}
