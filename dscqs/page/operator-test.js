/** One test: what it is, who takes part, how far they are, and its results. */

import { button, el, show } from "./dom.js";

const POLL_MS = 2000;
const LANGUAGES = [
  ["en", "English"], ["de", "Deutsch"], ["fr", "Français"], ["es", "Español"], ["tr", "Türkçe"],
  ["ja", "日本語"],
];
const STAGES = {
  instructions: "instructions", screening: "screening", stereo_acuity: "stereo acuity",
  fatigue_before: "questions before", training: "training", presentation: "test",
  break: "break", fatigue_after: "questions after", thanks: "finished",
  paused: "paused", withdrawn: "withdrawn",
};
const EXPORTS = [
  ["csv", "Votes (CSV)"], ["scores", "Scores (JSON)"], ["html", "Report (HTML)"],
  ["pdf", "Report (PDF)"], ["json", "Everything (JSON)"], ["sujson", "Votes (suJSON)"],
];

/** Show a test until `signal` ends it. */
export async function oneTest(context, main, id, signal) {
  const { api, attempt, follow } = context;
  const test = await attempt(() => api.get(`tests/${id}`));
  if (!test) return;
  const links = el("div", { class: "links" });
  const sessions = el("div", { class: "scroll" });
  const shown = new Map();
  const refresh = async () => {
    const rows = await follow(() => api.get(`tests/${id}/progress`));
    if (rows && !signal.aborted) renew(sessions, shown, rows, (row) => line(context, id, row, refresh));
  };
  show(main, "test",
    el("h1", { text: test.name }),
    facts(test),
    el("section", {}, el("h2", { text: "Sessions" }), sessions),
    el("section", {}, el("h2", { text: "Let somebody in" }), invitation(context, test, links), links),
    el("section", {}, el("h2", { text: "Results" }), downloads(test)));
  while (!signal.aborted) {
    await refresh();
    await new Promise((resolve) => setTimeout(resolve, POLL_MS));
  }
}

function facts(test) {
  const plan = test.plan;
  const said = [
    ["contents", plan.contents.length], ["conditions", plan.conditions.join(", ")],
    ["reference", plan.reference], ["displays", plan.displays.join(", ")],
    ["graded", plan.dimensions.join(", ")], ["presentations", test.presentations],
    ["minutes", test.minutes],
  ];
  return el("p", { class: "facts" },
    said.map(([name, value]) => el("span", {}, `${name} `, el("b", { text: String(value) }))));
}

/**
 * Bring the table of sessions up to date: only rows that changed are made anew, and the keyboard
 * stays where it was. `shown` keeps {said, element} of each session.
 */
function renew(place, shown, rows, make) {
  if (rows.length === 0) {
    place.replaceChildren(el("p", { class: "muted", text: "Nobody was let in yet." }));
    return;
  }
  for (const row of rows) {
    const said = JSON.stringify(row);
    if (shown.get(row.session)?.said !== said) shown.set(row.session, { said, element: make(row) });
  }
  const wanted = rows.map((row) => shown.get(row.session).element);
  const body = place.querySelector("tbody") ?? emptyTable(place);
  wanted.forEach((element, at) => {
    const present = body.children[at];
    if (present === undefined) body.append(element);
    else if (present !== element) replaceRow(present, element);
  });
}

/** Put a row in place of another, and the keyboard on its button of the same place. */
function replaceRow(present, element) {
  const at = [...present.querySelectorAll("button")].indexOf(document.activeElement);
  present.replaceWith(element);
  element.querySelectorAll("button")[at]?.focus();
}

function emptyTable(place) {
  const heads = ["Assessor", "Display", "Stage", "Progress", "Last heard", "Warnings", ""];
  const body = el("tbody");
  place.replaceChildren(el("table", {},
    el("thead", {}, el("tr", {}, heads.map((text) =>
      el(text ? "th" : "td", { text, scope: text ? "col" : null })))),
    body));
  return body;
}

function line(context, test, row, refresh) {
  const act = (...asked) => action(context, test, row, refresh, ...asked);
  const isOver = row.stage === "withdrawn" || row.stage === "thanks";
  const isHere = row.joined || ["paused", "withdrawn"].includes(row.stage);
  const what = row.role === "station" ? "" : ` (${row.role})`;
  return el("tr", {},
    el("td", {}, el("b", { text: row.assessor }), what),
    el("td", { text: row.display }),
    el("td", { text: isHere ? STAGES[row.stage] : "not there yet" }),
    el("td", { class: "number" },
      el("progress", { max: Math.max(row.total, 1), value: row.stage === "thanks" ? row.total : row.index,
        "aria-label": `progress of ${row.assessor}` }),
      ` ${row.stage === "thanks" ? row.total : row.index} / ${row.total}`),
    el("td", { text: row.last ? new Date(row.last * 1000).toLocaleTimeString("en-GB") : "–" }),
    el("td", {}, warnings(row)),
    el("td", {}, el("div", { class: "actions" },
      row.stage === "paused" ? act("resume", "Resume") : act("pause", "Pause", isOver),
      act("withdraw", "Withdraw", isOver,
        `End the session of ${row.assessor} for good? Votes are kept, and marked.`),
      act("erase", "Erase", false,
        `Erase the answers of the forms of ${row.assessor} for good? Votes are kept.`))));
}

function warnings(row) {
  const said = row.notes.map((note) =>
    el("div", { class: "warning", text: note.reason ? `${note.kind}: ${note.reason}` : note.kind }));
  if (row.failed) said.unshift(el("div", { class: "bad", text: row.failed === 1 ? "1 failed showing" : `${row.failed} failed showings` }));
  return said.length ? said.slice(0, 3) : [el("span", { class: "muted", text: "no warnings" })];
}

function action({ api, attempt }, test, row, refresh, name, text, isDisabled = false, question = "") {
  return button(text, async () => {
    if (question && !confirm(question)) return;
    await attempt(() => api.post(`tests/${test}/sessions/${row.session}/${name}`, {}));
    await refresh();
  }, { class: "small", disabled: isDisabled, "aria-label": `${text}: ${row.assessor} on ${row.display}` });
}

function invitation(context, test, links) {
  const { api, attempt, say } = context;
  const ask = async (event) => {
    event.preventDefault();
    const said = new FormData(form);
    const codes = said.get("assessors").split(/[\s,]+/).filter(Boolean);
    const common = { display: said.get("display"), language: said.get("language") };
    const send = (where, asked) =>
      attempt(() => api.post(`tests/${test.test}/${where}`, { ...common, ...asked }));
    const how = event.submitter.value;
    if (how === "dry") {
      const made = await send("dry-run", { assessor: "dry-run" });
      if (made) await add("Dry run: nothing is stored", common.display, made.link, false);
    } else if (codes.length === 0) {
      say("Whom? Enter the code of an assessor first.");
    } else if (how === "group") {
      const made = await send("groups", { assessors: codes });
      if (!made) return;
      await add("The screen", common.display, made.screen, false);
      for (const [code, link] of Object.entries(made.phones)) await add(code, common.display, link, true);
    } else {
      for (const assessor of codes) {
        const made = await send("links", { assessor });
        if (!made) return;
        await add(assessor, common.display, made.link, true);
      }
    }
  };
  /** The newest link into a session takes the place of the one before. */
  const add = async (name, display, link, hasCode) => {
    const made = await card(name, display, link, hasCode);
    const before = [...links.children].find((one) => one.dataset.of === made.dataset.of);
    if (before) before.replaceWith(made);
    else links.append(made);
  };
  const form = el("form", { onsubmit: ask },
    el("label", { class: "field" }, el("span", { text: "Codes of assessors (no names)" }),
      el("input", { name: "assessors", placeholder: "a1, a2, a3", autocomplete: "off" })),
    el("label", { class: "field" }, el("span", { text: "Display" }),
      el("select", { name: "display" }, test.plan.displays.map((text) => el("option", { text })))),
    el("label", { class: "field" }, el("span", { text: "Language" }),
      el("select", { name: "language" }, LANGUAGES.map(([value, text]) => el("option", { value, text })))),
    el("div", { class: "actions wide" },
      el("button", { class: "main", value: "links", text: "Links to stations" }),
      el("button", { value: "group", text: "A group before one screen" }),
      el("button", { value: "dry", text: "Dry run" })));
  if (/^(localhost|127\..*|\[::1\])$/.test(location.hostname)) {
    form.append(el("p", { class: "muted wide",
      text: `Links made here lead to ${location.host}, this machine alone. For telephones and ` +
        "stations elsewhere, open this page by the address under which they reach the service." }));
  }
  return form;
}

/** A link, to be opened once: as a button, as text, and for telephones as a code. */
async function card(name, display, link, hasCode) {
  const url = new URL(link, location.href).href;
  const made = el("div", { class: "link", "data-of": `${name} ${display}` },
    el("b", { text: name }), el("span", { class: "muted", text: ` on ${display}` }));
  if (hasCode) {
    const answer = await fetch("/dscqs/api/operator/codes", {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ text: url }),
    });
    if (answer.ok) {
      const address = URL.createObjectURL(await answer.blob());
      made.append(el("img", { src: address, alt: `QR code of the link of ${name}` }));
    }
  }
  const copy = button("Copy", async () => {
    await navigator.clipboard?.writeText(url);
    copy.textContent = "Copied";
  }, { class: "small" });
  made.append(
    el("code", { text: url }),
    el("div", { class: "actions" },
      el("a", { class: "button", href: url, target: "_blank", rel: "noopener", text: "Open here" }),
      copy));
  return made;
}

function downloads({ test, plan }) {
  const link = (query, text) =>
    el("a", { class: "button", href: `/dscqs/api/operator/tests/${test}/export?${query}`, text, download: true });
  const isOne = plan.displays.length * plan.dimensions.length === 1;
  return el("div", { class: "actions" },
    EXPORTS.map(([format, text]) => link(`format=${format}`, text)),
    plan.displays.flatMap((display) => plan.dimensions.map((dimension) => link(
      new URLSearchParams({ format: "sureal", display, dimension }),
      isOne ? "Votes (sureal)" : `Votes (sureal: ${display}, ${dimension})`))));
}
