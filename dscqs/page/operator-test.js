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
  ["pdf", "Report (PDF)"], ["json", "Everything (JSON)"],
];

/** Show a test until `signal` ends it. */
export async function oneTest(context, main, id, signal) {
  const { api, attempt } = context;
  const test = await attempt(() => api.get(`tests/${id}`));
  if (!test) return;
  const links = el("div", { class: "links" });
  const sessions = el("div", { class: "scroll" });
  show(main, "test",
    el("h1", { text: test.name }),
    facts(test),
    el("section", {}, el("h2", { text: "Sessions" }), sessions),
    el("section", {}, el("h2", { text: "Let somebody in" }), invitation(context, test, links), links),
    el("section", {}, el("h2", { text: "Results" }), downloads(id)));
  while (!signal.aborted) {
    if (!main.contains(document.activeElement?.closest?.("table"))) {
      const rows = await attempt(() => api.get(`tests/${id}/progress`));
      if (rows && !signal.aborted) sessions.replaceChildren(table(context, id, rows));
    }
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

function table(context, test, rows) {
  if (rows.length === 0) return el("p", { class: "muted", text: "Nobody was let in yet." });
  const heads = ["Assessor", "Display", "Stage", "Progress", "Last heard", "Warnings", ""];
  return el("table", {},
    el("thead", {}, el("tr", {}, heads.map((text) =>
      el(text ? "th" : "td", { text, scope: text ? "col" : null })))),
    el("tbody", {}, rows.map((row) => line(context, test, row))));
}

function line(context, test, row) {
  const isOver = row.stage === "withdrawn" || row.stage === "thanks";
  const what = row.role === "station" ? "" : ` (${row.role})`;
  return el("tr", {},
    el("td", {}, el("b", { text: row.assessor }), what),
    el("td", { text: row.display }),
    el("td", { text: row.joined ? STAGES[row.stage] : "not there yet" }),
    el("td", { class: "number" },
      el("progress", { max: Math.max(row.total, 1), value: row.stage === "thanks" ? row.total : row.index,
        "aria-label": `progress of ${row.assessor}` }),
      ` ${row.stage === "thanks" ? row.total : row.index} / ${row.total}`),
    el("td", { text: row.last ? new Date(row.last * 1000).toLocaleTimeString("en-GB") : "–" }),
    el("td", {}, warnings(row)),
    el("td", {}, el("div", { class: "actions" },
      row.stage === "paused"
        ? action(context, test, row, "resume", "Resume")
        : action(context, test, row, "pause", "Pause", isOver),
      action(context, test, row, "withdraw", "Withdraw", isOver,
        `End the session of ${row.assessor} for good? Votes are kept, and marked.`),
      action(context, test, row, "erase", "Erase", false,
        `Erase the answers of the forms of ${row.assessor} for good? Votes are kept.`))));
}

function warnings(row) {
  const said = row.notes.map((note) =>
    el("div", { class: "warning", text: note.reason ? `failed: ${note.reason}` : note.kind }));
  if (row.failed) said.unshift(el("div", { class: "bad", text: row.failed === 1 ? "1 failed showing" : `${row.failed} failed showings` }));
  return said.length ? said.slice(0, 3) : [el("span", { class: "muted", text: "none" })];
}

function action({ api, attempt, open }, test, row, name, text, isDisabled = false, question = "") {
  return button(text, async () => {
    if (question && !confirm(question)) return;
    await attempt(() => api.post(`tests/${test}/sessions/${row.session}/${name}`, {}));
    await open(test);
  }, { class: "small", disabled: isDisabled, "aria-label": `${text}: ${row.assessor} on ${row.display}` });
}

function invitation(context, test, links) {
  const { api, attempt } = context;
  const ask = async (event) => {
    event.preventDefault();
    const said = new FormData(form);
    const codes = said.get("assessors").split(/[\s,]+/).filter(Boolean);
    const common = { display: said.get("display"), language: said.get("language") };
    const how = event.submitter.value;
    links.replaceChildren();
    if (how === "group") {
      const made = await attempt(() => api.post(`tests/${test.test}/groups`, { ...common, assessors: codes }));
      if (!made) return;
      await add("The screen", made.screen, false);
      for (const [code, link] of Object.entries(made.phones)) await add(code, link, true);
      return;
    }
    const where = how === "dry" ? "dry-run" : "links";
    for (const assessor of how === "dry" ? ["dry-run"] : codes) {
      const made = await attempt(() => api.post(`tests/${test.test}/${where}`, { ...common, assessor }));
      if (!made) return;
      if (how === "dry") await add("Dry run: nothing is stored", made.link, false);
      else await add(assessor, made.link, true);
    }
  };
  const add = async (title, link, hasCode) => links.append(await card(title, link, hasCode));
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
  return form;
}

/** A link, to be opened once: as a button, as text, and for telephones as a code. */
async function card(title, link, hasCode) {
  const url = new URL(link, location.href).href;
  const made = el("div", { class: "link" }, el("b", { text: title }));
  if (hasCode) {
    const answer = await fetch("/dscqs/api/operator/codes", {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ text: url }),
    });
    if (answer.ok) {
      const address = URL.createObjectURL(await answer.blob());
      made.append(el("img", { src: address, alt: `QR code of the link of ${title}` }));
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

function downloads(id) {
  return el("div", { class: "actions" },
    EXPORTS.map(([format, text]) =>
      el("a", { class: "button", href: `/dscqs/api/operator/tests/${id}/export?format=${format}`, text, download: true })));
}
