/** Makes a test from a template; the plan is tried while it is described. */

import { el, show } from "./dom.js";

const ORDER = [
  ["repetitions", "Times each pair is shown"],
  ["dummies", "Dummies at the start", "Presentations that get people used to it: their votes do not count, which nobody is told."],
  ["coherence", "Pairs that come once more", "The same for everybody: does an assessor grade a pair alike both times?"],
  ["break_every", "A break after so many (0: none)"],
  ["break_s", "Length of a break [s]"],
  ["seed", "Seed of the order"],
];
const SHOWING = [
  ["timing.show_s", "A or B is shown [s]"],
  ["timing.grey_s", "Grey between [s]"],
  ["timing.showings", "Times A and B are shown in turn"],
  ["timing.vote_s", "Vote [s]"],
  ["timing.tolerance_s", "Off by more has failed [s]", "A presentation with an interval that is this much too long or too short is offered again."],
  ["grey", "Level of the grey, 0 to 255"],
];
const STAGES = {
  instructions: "instructions",
  screening: "eyes",
  stereo_acuity: "stereo acuity",
  fatigue_before: "fatigue before",
  fatigue_after: "fatigue after",
};
const TRY_AFTER_MS = 250;

function field(label, input, hint = null) {
  const labelled = el("label", { class: "field" }, el("span", { text: label }), input);
  if (!hint) return labelled;
  const id = `hint-${input.name}`;
  input.setAttribute("aria-describedby", id);
  return el("div", {}, labelled, el("small", { class: "muted", id, text: hint }));
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
    point(form, tried.message ?? "");
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
    head("Order"),
    field("Training contents", el("input", { name: "training", placeholder: "content, content" })),
    numbers(ORDER, making),
    head("Presentation"),
    field("Variant", select("variant", [
      ["II", "II: A and B in turn, then the vote"], ["I", "I: the assessor switches freely"]])),
    numbers(SHOWING, making),
    checks("captions", "Captions", [["captions", "letters A and B on the grey"]], ["captions"]),
    head("Session"),
    checks("stages", "Stages", making.stages.map((key) => [key, STAGES[key]]), making.stages),
    checks("long_session", "Length", [["long_session", "more than 30 minutes are wanted"]], []));
}

function head(text) {
  return el("h2", { class: "wide", text });
}

function numbers(names, making) {
  return names.map(([name, text, hint]) => {
    const { usual, least, most, whole } = making.numbers[name];
    return field(text, el("input", {
      type: "number", name, value: usual, min: least, max: most, step: whole ? 1 : "any",
    }), hint);
  });
}

/** Mark the field that a message of the plan begins with. */
function point(form, message) {
  const wrong = message.split(":")[0];
  for (const input of form.elements) {
    if (input.name && input.name === wrong) input.setAttribute("aria-invalid", "true");
    else input.removeAttribute("aria-invalid");
  }
}

/** Return what the form says, as the service takes it. */
function wanted(form) {
  const said = new FormData(form);
  const fields = {
    displays: said.getAll("displays"),
    dimensions: said.getAll("dimensions"),
    stages: said.getAll("stages"),
    variant: said.get("variant"),
    captions: said.has("captions"),
    long_session: said.has("long_session"),
    timing: {},
  };
  for (const [name] of [...ORDER, ...SHOWING]) {
    const value = form.elements[name].valueAsNumber;
    if (name.startsWith("timing.")) fields.timing[name.slice("timing.".length)] = value;
    else fields[name] = value;
  }
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
