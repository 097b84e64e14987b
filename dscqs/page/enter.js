/** Where a link leads: it is used up when the assessor says so, not when something looks at it. */

import { Api, ApiError } from "./api.js";
import { button, el, show } from "./dom.js";
import { hex } from "./sha256.js";
import { browserLanguage, textsOf } from "./texts.js";

const KNOWN_AS = "dscqs-browser";

const main = document.getElementById("page");
const banner = document.getElementById("banner");
const language = browserLanguage();
const texts = await textsOf(language);
const api = new Api((isInTrouble) => {
  banner.textContent = isInTrouble ? texts.trouble : "";
});

/** The secret by which a link that was opened here knows this browser again. */
function browser() {
  const known = localStorage.getItem(KNOWN_AS) ?? hex(crypto.getRandomValues(new Uint8Array(16)));
  localStorage.setItem(KNOWN_AS, known);
  return known;
}

async function enter(link) {
  try {
    await api.post("enter", { link, browser: browser() });
    location.replace("assessor.html");
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    const { title, text } = texts.noSession;
    refuse(title, error.status === 410 ? texts.enter.used : text);
  }
}

function refuse(title, text) {
  show(main, "no-session", el("h1", { text: title }), el("p", { text }));
}

function ask() {
  const link = location.hash.slice(1);
  if (link === "") {
    refuse(texts.noSession.title, texts.noSession.text);
    return;
  }
  const go = button(texts.begin, () => {
    go.disabled = true;
    enter(link);
  }, { class: "main" });
  show(main, "enter", el("h1", { text: texts.title }), el("p", { text: texts.enter.text }),
    el("div", { class: "actions" }, go));
  go.focus();
}

document.documentElement.lang = language;
document.title = texts.title;
addEventListener("hashchange", ask);
ask();
