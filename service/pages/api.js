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

/** The name of the work whose trouble is shown. */
let troubled = null;

/**
 * Run what may fail; tell people where it does, until work of the same name does not.
 *
 * Work without a name is what somebody asked for just now: a look at the service that goes well
 * does not take back what is said of it.
 */
export async function trying(work) {
  const place = document.getElementById("trouble");
  try {
    const done = await work();
    if (troubled === work.name) place.hidden = true;
    return done;
  } catch (error) {
    place.textContent = error instanceof TypeError ? "The service cannot be reached." : error.message;
    place.hidden = false;
    troubled = work.name;
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

/**
 * Seconds until all `total` frames are done, by the pace of those that were: `frames` are
 * `{ at, done }`, milliseconds and how many then; null before there is a pace.
 */
export function secondsLeft(frames, total) {
  const [first, last] = [frames[0], frames.at(-1)];
  if (frames.length < 2 || last.done <= first.done) return null;
  return ((last.at - first.at) / 1000 / (last.done - first.done)) * (total - last.done);
}

export function moment(text) {
  return new Date(text).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
}

/** A form of export for people: `half-sbs · mp4`. */
export function formName(form) {
  const kind = form.frames && !form.video ? "PNG" : [form.container, form.codec].filter(Boolean).join(" ");
  return `${form.layout} · ${kind}`;
}

/** The name of a job for people, with the form that an export has, and enough of its id. */
export function jobName(job) {
  const form = job.request.export ? [formName(job.request.export)] : [];
  return [job.name, ...form, job.id.slice(0, 8)].join(" · ");
}
