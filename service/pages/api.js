/** Talking to the service, and saying what it says: shared by all pages. */

/** What the service answered when it refused (RFC 9457). */
export class Problem extends Error {
  constructor(status, said) {
    super(said.detail ? `${said.title}: ${said.detail}` : said.title ?? `status ${status}`);
    this.status = status;
  }
}

/** Ask for JSON; without a token that is good, go to the page that takes one. */
export async function ask(path, { method = "GET", body, headers = {} } = {}) {
  const json = body !== undefined;
  const answer = await fetch(path, {
    method,
    headers: json ? { "Content-Type": "application/json", ...headers } : headers,
    body: json ? JSON.stringify(body) : undefined,
  });
  if (answer.status === 401) {
    toLogin();
    return new Promise(() => {}); // the page is being left
  }
  if (!answer.ok) throw await problemOf(answer);
  return answer.status === 204 ? null : answer.json();
}

export async function problemOf(answer) {
  try {
    return new Problem(answer.status, await answer.json());
  } catch {
    return new Problem(answer.status, {});
  }
}

export function toLogin() {
  const here = location.pathname + location.search;
  location.assign(`/login?next=${encodeURIComponent(here)}`);
}

/** Show the button that ends a session where there is one to end. */
export async function showLeave() {
  const button = document.getElementById("leave");
  const who = await ask("/api/v1/session");
  if (who.name === "anybody") return;
  button.hidden = false;
  button.textContent = `Log out ${who.name}`;
  button.addEventListener("click", async () => {
    await ask("/api/v1/session", { method: "DELETE" });
    location.assign("/login");
  });
}

/** Run what may fail; tell people where it does, and take it back where it does not. */
export async function trying(work) {
  const place = document.getElementById("trouble");
  try {
    const done = await work();
    place.hidden = true;
    return done;
  } catch (error) {
    place.textContent = error instanceof TypeError ? "The service cannot be reached." : error.message;
    place.hidden = false;
    return undefined;
  }
}

/** Do something now and again while somebody looks. */
export function repeat(work, seconds) {
  let timer;
  const turn = async () => {
    clearTimeout(timer);
    if (!document.hidden) await trying(work);
    timer = setTimeout(turn, seconds * 1000);
  };
  document.addEventListener("visibilitychange", () => document.hidden || turn());
  return turn();
}

/** Make an element: `element("a", { href, class: "button" }, "text", child, …)`. */
export function element(name, attributes = {}, ...content) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value === true) made.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(key, value);
  }
  made.append(...content);
  return made;
}

export function stateOf(state) {
  return element("span", { class: `state ${state}` }, state);
}

export function bytes(count) {
  const units = ["B", "KiB", "MiB", "GiB", "TiB"];
  let unit = 0;
  while (count >= 1024 && unit < units.length - 1) {
    count /= 1024;
    unit += 1;
  }
  return `${count.toFixed(unit && count < 100 ? 1 : 0)} ${units[unit]}`;
}

export function duration(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  const [h, m, s] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  const two = (number) => String(number).padStart(2, "0");
  return h ? `${h}:${two(m)}:${two(s)}` : `${m}:${two(s)}`;
}

export function moment(text) {
  return new Date(text).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
}

/** The name of a job for people: its scene, without the folders, or that it is an export. */
export function jobName(job) {
  const scene = job.request.export ? "export" : job.request.scene ?? Object.keys(job.request.uploads ?? {})[0]?.split("/")[0];
  const parts = (scene ?? "scene").split("/").filter((part) => part && part !== "scene.json");
  return `${parts.at(-1) ?? "scene"} · ${job.id.slice(0, 8)}`;
}
