/** The operator's page: log in, choose or make a test, watch over its sessions. */

import { Api, ApiError } from "./api.js";
import { button, el } from "./dom.js";
import { newTest } from "./operator-new.js";
import { oneTest } from "./operator-test.js";

const head = document.getElementById("head");
const body = document.getElementById("body");
const banner = document.getElementById("banner");

const api = new Api(
  (isLost) => say(isLost ? "The service cannot be reached. Trying again…" : ""),
  "/dscqs/api/operator/",
);

/** What the page shows now ends when another takes its place. */
let ending = new AbortController();

function say(text) {
  banner.textContent = text;
}

/** Do something for the operator; what goes wrong is said at the foot of the page. */
async function attempt(work) {
  say("");
  return follow(work);
}

/** Do something of the page's own: it takes nothing back that was said to the operator. */
async function follow(work) {
  try {
    return await work();
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    if (error.status === 401) login();
    else say(error.message);
    return undefined;
  }
}

const context = { api, attempt, follow, say, open: (test) => desk(test) };

function login() {
  ending.abort();
  head.replaceChildren(el("a", { class: "brand", href: "/", text: "depthsr tests" }));
  const token = el("input", { type: "password", name: "token", autocomplete: "current-password", required: true });
  const wrong = el("p", { class: "bad", role: "alert" });
  const send = async (event) => {
    event.preventDefault();
    try {
      await api.post("login", { token: token.value.trim() });
      await desk(null);
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      wrong.textContent = "This token lets no operator in.";
    }
  };
  body.replaceChildren(
    el("main", {},
      el("div", { class: "login" },
        el("h1", { text: "Operator" }),
        el("p", { class: "muted", text: "Log in with a token of the scope “assess”, or with the one in operator.token of the data folder." }),
        el("form", { onsubmit: send },
          el("label", { class: "field" }, el("span", { text: "Token" }), token),
          wrong,
          el("div", { class: "actions" }, el("button", { class: "main", text: "Log in" }))))),
  );
  token.focus();
}

/** Show the list of tests, and one of them, or the form of a new one. */
async function desk(chosen) {
  const who = await attempt(() => api.get("whoami"));
  const tests = who && (await attempt(() => api.get("tests")));
  if (!tests) return;
  ending.abort();
  ending = new AbortController();
  head.replaceChildren(
    el("a", { class: "brand", href: "/", text: "depthsr tests" }),
    el("a", { class: "button small", href: "calibrate.html", target: "_blank", rel: "noopener", text: "Calibrate a display" }),
    el("span", { class: "who", text: who.name }),
    button("Log out", async () => {
      await attempt(() => api.post("logout", {}));
      login();
    }, { class: "small" }),
  );
  const main = el("main", {});
  const current = chosen ?? tests[0]?.test ?? null;
  body.replaceChildren(el("div", { class: "columns" }, list(tests, current), main));
  document.title = "Tests – depthsr";
  if (current === null || current === "new") await newTest(context, main);
  else await oneTest(context, main, current, ending.signal);
}

function list(tests, current) {
  return el("nav", { "aria-label": "Tests" },
    button("New test", () => desk("new"), { class: "main" }),
    el("ul", {},
      tests.map((test) =>
        el("li", {},
          el("button", { type: "button", onclick: () => desk(test.test), "aria-current": String(test.test === current) },
            test.name,
            el("small", { text: `${new Date(test.created * 1000).toLocaleString()} · ${test.minutes} min` }))))));
}

await desk(null);
