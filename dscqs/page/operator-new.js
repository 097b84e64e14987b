/** Makes a test from a template; the plan is tried while it is described. */

import { el, show } from "./dom.js";

const NUMBERS = [
  ["repetitions", "Times each pair is shown", 1, 1, 20],
  ["dummies", "Dummies at the start", 5, 0, 20],
  ["coherence", "Pairs that come once more", 0, 0, 100],
  ["break_every", "A break after so many (0: none)", 0, 0, 1000],
  ["seed", "Seed of the order", 1, 0, 1e9],
];
const TIMES = [
  ["show_s", "A or B is shown [s]", 3],
  ["grey_s", "Grey between [s]", 2],
  ["vote_s", "Vote [s]", 8],
];
const TRY_AFTER_MS = 250;

function field(label, input) {
  return el("label", { class: "field" }, el("span", { text: label }), input);
}

function counted(number, what) {
  return `${number} ${what}${number === 1 ? "" : "s"}`;
}

function select(name, options) {
  return el("select", { name }, options.map(([value, text]) => el("option", { value, text })));
}

function checks(name, legend, options, checked, shape = null) {
  return el("fieldset", { class: "wide" },
    el("legend", { text: legend }),
    el("div", { class: shape },
      options.map(([value, text]) =>
        el("label", {},
          el("input", { type: "checkbox", name, value, checked: checked.includes(value) }),
          el("span", { text })))));
}

/** Show the form; the test that it makes is opened. */
export async function newTest(context, main) {
  const { api, attempt, open } = context;
  const making = await attempt(() => api.get("making"));
  if (!making) return;
  if (making.folders.length === 0) {
    show(main, "new", el("h1", { text: "New test" }),
      el("section", {},
        el("h2", { text: "There are no stimuli yet" }),
        el("p", { text: "Make some with “depthsr dscqs stimuli”, in a folder under one of the service's roots (--roots), and come back." })));
    return;
  }
  const form = describe(making);
  const summary = el("p", { class: "summary wide", role: "status" });
  const make = el("button", { class: "main", text: "Make the test", disabled: true });
  form.append(summary, el("div", { class: "actions wide" }, make));
  let plan = null;
  let newest = 0;
  const tryIt = async () => {
    const mine = ++newest;
    const tried = await attemptQuietly(api, wanted(form));
    if (mine !== newest) return;
    plan = tried.plan ?? null;
    make.disabled = plan === null;
    summary.classList.toggle("wrong", plan === null);
    summary.textContent = plan === null
      ? tried.message
      : `${counted(plan.contents.length, "content")} × ${counted(plan.conditions.length, "condition")} against `
        + `“${plan.reference}”: ${tried.presentations} presentations, ${tried.minutes} minutes a session`;
  };
  let timer = 0;
  form.addEventListener("input", () => {
    make.disabled = true;
    clearTimeout(timer);
    timer = setTimeout(tryIt, TRY_AFTER_MS);
  });
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    make.disabled = true;
    const made = await attempt(() => api.post("tests", plan));
    if (made) await open(made.test);
    else make.disabled = false;
  });
  show(main, "new", el("h1", { text: "New test" }),
    el("p", { class: "muted", text: "What is described here is tried at once; nothing is stored before you make it." }),
    el("section", {}, form));
  await tryIt();
}

function describe(making) {
  const templates = Object.entries(making.templates);
  const here = new Set(making.calibrated);
  const displays = Object.entries(making.displays)
    .sort(([one], [other]) => here.has(other) - here.has(one));
  return el("form", {},
    field("Stimuli", select("folder", making.folders.map((one) =>
      [one.folder, `${one.label} (${one.contents.length} × ${one.conditions.length}, ${one.kind}s)`]))),
    field("Template", select("template", templates.map(([key, one]) => [key, one.title]))),
    field("Name", el("input", { name: "name", maxlength: 200, placeholder: "as the template" })),
    checks("displays", "Displays", displays.map(([key, title]) => [key, `${key} – ${title}`]), [displays[0][0]], "options"),
    checks("dimensions", "Graded", making.dimensions.map((key) => [key, key]), ["quality"]),
    field("Training contents", el("input", { name: "training", placeholder: "content, content" })),
    NUMBERS.map(([name, text, value, min, max]) =>
      field(text, el("input", { type: "number", name, value, min, max, step: 1 }))),
    TIMES.map(([name, text, value]) =>
      field(text, el("input", { type: "number", name, value, min: 0, max: 60, step: 0.5 }))),
    field("Presentation", select("variant", [
      ["II", "II: A, B, A, B, then the vote"], ["I", "I: the assessor switches freely"]])),
    el("fieldset", {},
      el("label", {},
        el("input", { type: "checkbox", name: "long_session" }),
        el("span", { text: "More than 30 minutes are wanted" }))));
}

/** Return what the form says, as the service takes it. */
function wanted(form) {
  const said = new FormData(form);
  const fields = {
    displays: said.getAll("displays"),
    dimensions: said.getAll("dimensions"),
    variant: said.get("variant"),
    long_session: said.has("long_session"),
    timing: Object.fromEntries(TIMES.map(([name]) => [name, Number(said.get(name))])),
  };
  for (const [name] of NUMBERS) fields[name] = Number(said.get(name));
  return {
    folder: said.get("folder"),
    template: said.get("template"),
    name: said.get("name").trim(),
    training: said.get("training").split(",").map((one) => one.trim()).filter(Boolean),
    fields,
  };
}

async function attemptQuietly(api, asked) {
  try {
    return await api.post("plans", asked);
  } catch (error) {
    return { message: error.message };
  }
}
