/** The page of grades, and how they reach the server whatever happens. */

import { button, el, show } from "./dom.js";
import { makeScales } from "./scales.js";
import { hex } from "./sha256.js";

const KEPT = "dscqs-pending-vote";

/**
 * Ask for grades and send them; resolves with the next state.
 *
 * @param context {api, main, texts}
 * @param wanted {ticket, dimensions, head, remindAfterS, lookAgain}: `lookAgain` shows the
 *   pictures once more, or is null
 */
export function vote({ api, main, texts }, { ticket, dimensions, head, remindAfterS, lookAgain }) {
  return new Promise((resolve, reject) => {
    const hint = el("p", { class: "hint", role: "status", text: texts.gradeHint });
    const send = button(texts.submit, () => submit(), { class: "main", disabled: true });
    const scales = makeScales({
      dimensions,
      words: texts,
      onchange: () => {
        send.disabled = scales.grades() === null;
      },
    });
    const reminder = setTimeout(() => {
      hint.textContent = texts.gradeReminder;
    }, 1000 * remindAfterS);
    const submit = async () => {
      const grades = scales.grades();
      if (grades === null || main.dataset.page !== "vote") return;
      clearTimeout(reminder);
      send.disabled = true;
      hint.textContent = texts.gradeSaving;
      scales.element.inert = true;
      const body = { ticket, submission: freshName(), grades };
      sessionStorage.setItem(KEPT, JSON.stringify(body));
      try {
        const state = await api.post("grades", body);
        sessionStorage.removeItem(KEPT);
        resolve(state);
      } catch (error) {
        sessionStorage.removeItem(KEPT);
        reject(error);
      }
    };
    show(
      main,
      "vote",
      el("header", {}, el("h1", { text: texts.gradeTitle }), el("p", { class: "head", text: head })),
      scales.element,
      hint,
      el(
        "div",
        { class: "actions" },
        lookAgain && button(texts.lookAgain, lookAgain, { class: "quiet" }),
        send,
      ),
    );
    scales.first.focus({ preventScroll: true });
  });
}

/** Send the vote that was being sent when the page was left, if there is one. */
export async function sendPending(api) {
  const kept = sessionStorage.getItem(KEPT);
  if (kept === null) return;
  try {
    await api.post("grades", JSON.parse(kept));
  } catch {
    api.note("pending-vote", { outcome: "refused" });
  }
  sessionStorage.removeItem(KEPT);
}

function freshName() {
  return hex(crypto.getRandomValues(new Uint8Array(16)));
}
