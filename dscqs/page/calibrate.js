/** The operator's page that measures a display and stores its profile. */

import { Api, ApiError } from "./api.js";
import { button, el, show } from "./dom.js";
import { MODES, refusals, screenSize, viewingDistance, warnings } from "./layout.js";
import { lightOf, makePattern, PATTERNS } from "./patterns.js";
import { reasonList, Stage } from "./stage.js";
import { textsOf } from "./texts.js";

/** Width of a bank card, mm (ISO/IEC 7810 ID-1). */
const CARD_MM = 85.6;
const CARD_SHAPE = 85.6 / 53.98;
const GLASSES = ["none", "polarising", "shutter", "red-cyan"];
const NO_LIGHT = [0, 0, 0];

const main = document.getElementById("page");
const api = new Api(() => {}, "/dscqs/api/operator/");
const texts = await textsOf("en");

try {
  await begin(await api.get("displays"));
} catch (error) {
  const isOut = error instanceof ApiError && error.status === 401;
  show(main, "calibrate", el("h1", { text: "Calibrate a display" }),
    isOut
      ? el("p", {}, "Log in as an operator first, on ",
        el("a", { href: "operator.html", text: "the operator's page" }), ", then load this page again.")
      : el("p", { text: error.message }));
}

async function begin(profiles) {
  const wanted = new URLSearchParams(location.search).get("display") ?? "";
  const first = wanted in profiles ? wanted : Object.keys(profiles)[0];
  const form = { name: first, chosen: profiles[first], profile: { ...profiles[first] } };
  const stage = new Stage(document.getElementById("display"), form.profile);
  const render = () => page(profiles, form, stage, render);
  render();
}

function page(profiles, form, stage, render) {
  const { profile } = form;
  const said = el("p", { class: "hint", role: "status" });
  const distance = el("p", { class: "hint" });
  const tell = () => {
    const mm = viewingDistance(profile);
    distance.textContent = mm === null
      ? "Measure the pixels to know the distance."
      : `That is ${Math.round(mm)} mm from the screen.`;
  };
  tell();
  const save = async () => {
    try {
      const stored = { ...profile, calibrated: new Date().toISOString().slice(0, 16) + " UTC" };
      form.profile = await api.put(`displays/${encodeURIComponent(form.name)}`, stored);
      profiles[form.name] = { ...form.profile };
      form.chosen = profiles[form.name];
      render();
      main.querySelector("[role=status]").textContent = `Stored as ${form.name}.`;
    } catch (error) {
      said.textContent = error.message;
    }
  };
  show(
    main,
    "calibrate",
    el("h1", { text: "Calibrate a display" }),
    el(
      "div",
      { class: "grid" },
      choice("Profile", Object.keys(profiles), form.name, (name) => {
        form.name = name;
        form.chosen = profiles[name];
        form.profile = { ...profiles[name] };
        stage.profile = form.profile;
        render();
      }),
      text("Store as", form.name, (value) => { form.name = value; }),
      text("Description", profile.title, (value) => { profile.title = value; }),
      choice("How it takes two eyes", Object.keys(MODES), profile.mode, (mode) => {
        profile.mode = mode;
        if (mode === "frame-sequential") profile.eye_code = "blue-line";
        render();
      }),
      choice("Glasses", GLASSES, profile.glasses, (value) => { profile.glasses = value; }),
      number("Width of the signal, pixels", profile.width_px, 1, (v) => { profile.width_px = v; tell(); }),
      number("Height of the signal, pixels", profile.height_px, 1, (v) => { profile.height_px = v; tell(); }),
      number("Distance, heights of the screen", profile.distance_heights, 0.1, (v) => {
        profile.distance_heights = v;
        tell();
      }),
      number("Pixel pitch, mm", profile.pixel_pitch_mm, 0.0001, (v) => {
        profile.pixel_pitch_mm = v;
        tell();
      }),
    ),
    distance,
    el("div", { class: "actions" },
      button("Take the size of this screen", async () => {
        await stage.fill();
        const seen = await stage.environment.observe(stage.drawing);
        if (seen.canvas) {
          const [width, height] = seen.canvas;
          const isAnother = width !== profile.width_px || height !== profile.height_px;
          // the pitch of another screen would make the rings and the squares of wrong sizes
          if (isAnother && profile.pixel_pitch_mm === form.chosen.pixel_pitch_mm) {
            profile.pixel_pitch_mm = null;
          }
          [profile.width_px, profile.height_px] = seen.canvas;
          profile.title = profile.title.replace(/\d+ × \d+/, seen.canvas.join(" × "));
        }
        render();
      })),
    card(profile, () => render()),
    el("h2", { text: "Patterns" }),
    el("p", { class: "hint", text: state(profile) }),
    el("ul", { class: "plain" },
      Object.entries(PATTERNS).map(([name, words]) =>
        el("li", {},
          button(name, () => look(name, profile, stage).then((wrong) => {
            render();
            if (wrong) main.querySelector(".wrong").replaceChildren(...wrong);
          })),
          el("span", { text: words })))),
    el("div", { class: "wrong" }),
    el("div", { class: "actions" }, button("Store the profile", save, { class: "main" })),
    said,
  );
}

function state({ swap, phase, crosstalk }) {
  const part = crosstalk === null ? "not measured" : `${(100 * crosstalk).toFixed(1)} %`;
  return `Eyes ${swap ? "exchanged" : "as they are"}; lines shifted by ${phase}; crosstalk ${part}. ` +
    "The space bar or a click ends a pattern.";
}

/** Show one pattern on the full screen until it is left; resolves with what is or may be wrong, or null. */
async function look(name, profile, stage) {
  await stage.fill();
  stage.profile = profile;
  stage.drawing.setProfile(profile);
  const seen = await stage.environment.observe(stage.drawing);
  const refused = refusals(profile, seen);
  if (refused.length || stage.isHeadset) {
    const words = texts.display;
    return [el("p", { text: words.cannot }), reasonList(refused, words),
      reasonList(warnings(profile, seen), words)];
  }
  let level = profile.crosstalk === null ? 60 : nearestLevel(profile.crosstalk);
  let source = null;
  let isOn = true;
  let turn = 0;
  const renew = () => {
    if (source) stage.drawing.free(source);
    const [width, height] = screenSize(profile);
    source = stage.drawing.fromPicture(makePattern(name, { width, height, level }), { stereo: true });
    stage.drawing.setProfile(profile);
    stage.drawing.draw(source, NO_LIGHT, turn);
  };
  const turns = () => {
    if (!isOn) return;
    turn = 1 - turn;
    if (profile.mode === "frame-sequential") stage.drawing.draw(source, NO_LIGHT, turn);
    requestAnimationFrame(turns);
  };
  stage.reveal(true);
  renew();
  turns();
  await new Promise((resolve) => {
    const press = (event) => {
      const key = event.key.toLowerCase();
      if (key === "s") profile.swap = !profile.swap;
      else if (key === "p") profile.phase = 1 - profile.phase;
      else if (key === "arrowup" && name === "crosstalk") level = Math.min(255, level + 1);
      else if (key === "arrowdown" && name === "crosstalk") level = Math.max(0, level - 1);
      else if (key === " " || key === "enter" || key === "escape") {
        end();
        return;
      } else return;
      event.preventDefault();
      renew();
    };
    const end = () => {
      removeEventListener("keydown", press);
      stage.canvas.removeEventListener("click", end);
      resolve();
    };
    addEventListener("keydown", press);
    stage.canvas.addEventListener("click", end);
  });
  isOn = false;
  stage.reveal(false);
  stage.drawing.free(source);
  if (name === "crosstalk") profile.crosstalk = Math.round(1e5 * lightOf(level)) / 1e5;
  const warned = warnings(profile, seen).filter((one) => one.code !== "not-calibrated");
  return warned.length ? [reasonList(warned, texts.display)] : null;
}

function nearestLevel(part) {
  let level = 0;
  while (level < 255 && lightOf(level) < part) level += 1;
  return level;
}

/** A card on the screen, to be made as large as a real one: gives the pixel pitch. */
function card(profile, onchange) {
  const shape = el("div", { class: "card", "aria-hidden": "true" });
  const draw = (pixels) => {
    shape.style.setProperty("width", `${pixels / devicePixelRatio}px`);
    shape.style.setProperty("height", `${pixels / CARD_SHAPE / devicePixelRatio}px`);
  };
  const begin = Math.round(CARD_MM / (profile.pixel_pitch_mm ?? 0.28));
  draw(begin);
  return el(
    "details",
    {},
    el("summary", { text: "Measure the pixels with a bank card" }),
    el("p", { class: "hint", text: "Hold a card against the screen and make the shape as wide as it." }),
    shape,
    el("input", {
      type: "range", min: "80", max: "2400", value: begin, "aria-label": "Width of the card, pixels",
      oninput: (event) => draw(Number(event.target.value)),
      onchange: (event) => {
        profile.pixel_pitch_mm = Math.round((1e4 * CARD_MM) / Number(event.target.value)) / 1e4;
        onchange();
      },
    }),
  );
}

function labelled(label, input) {
  return el("label", { class: "entry" }, el("span", { text: label }), input);
}

function choice(label, names, chosen, onchange) {
  return labelled(label, el("select", { onchange: (event) => onchange(event.target.value) },
    names.map((name) => el("option", { value: name, text: name, selected: name === chosen }))));
}

function text(label, value, oninput) {
  return labelled(label, el("input", {
    type: "text", value, maxlength: "200", oninput: (event) => oninput(event.target.value),
  }));
}

function number(label, value, step, oninput) {
  return labelled(label, el("input", {
    type: "number", value: value ?? "", step, min: "0",
    oninput: (event) => {
      const { valueAsNumber } = event.target;
      oninput(Number.isFinite(valueAsNumber) ? valueAsNumber : null);
    },
  }));
}
