/** The screen that a group looks at: shows, then waits until the telephones have voted. */

import { button, el, show } from "./dom.js";
import { wait } from "./pages.js";
import { release } from "./showing.js";
import { numberOf, showOne } from "./station.js";
import { fill } from "./texts.js";

const POLL_MS = 1000;

/** Show one presentation to the group; resolves with the next state. */
export async function groupScreen(context, state) {
  const { api, main, texts } = context;
  if (!state.voting) {
    const shown = await showOne(context, state);
    if (shown === null) return api.get("state");
    release(shown);
  }
  const count = el("p", { class: "count", role: "status" });
  let isForced = false;
  show(
    main,
    "group-vote",
    el("h1", { text: texts.screen.vote }),
    el("p", { class: "head", text: numberOf(texts, state) }),
    count,
    el("div", { class: "actions" },
      button(texts.screen.go, () => { isForced = true; }, { class: "quiet" })),
  );
  for (;;) {
    const now = isForced
      ? await api.post("continue", { stage: state.stage })
      : await api.get("state");
    if (!now.voting || now.index !== state.index || now.stage !== state.stage) return now;
    count.textContent = fill(texts.screen.count, now.votes);
    await wait(POLL_MS);
  }
}
