/** A telephone of a group: waits while the screen shows, then takes the grades. */

import { el, show } from "./dom.js";
import { wait } from "./pages.js";
import { numberOf } from "./station.js";
import { vote } from "./vote.js";

const POLL_MS = 1000;
const REMIND_S = 20;

/** Wait for the vote of the present presentation; resolves with the next state. */
export async function phone(context, state) {
  const { api, main, texts } = context;
  if (state.ticket) {
    return vote(context, {
      ticket: state.ticket,
      dimensions: state.dimensions,
      head: numberOf(texts, state),
      remindAfterS: REMIND_S,
      lookAgain: null,
    });
  }
  if (main.dataset.page !== "phone-wait") {
    show(main, "phone-wait", el("h1", { text: texts.phone.wait }),
      el("p", { text: texts.phone.waitText }));
  }
  await wait(POLL_MS);
  return api.get("state");
}
