/** A job: how far it is, what came of it, and other forms of it. */

import {
  ask, bytes, duration, element, formName, jobName, moment, secondsLeft, showLeave, stateOf, trying,
} from "./api.js";
import { plotsOf, viewRows } from "./report.js";

const id = location.pathname.split("/").at(-1);
const here = `/api/v1/jobs/${encodeURIComponent(id)}`;
const place = (name) => document.getElementById(name);
const FINAL = ["succeeded", "failed", "cancelled"];

async function refresh() {
  const job = await ask(here);
  const isExport = Boolean(job.request.export);
  const name = jobName(job);
  document.title = `depthsr: ${name}`;
  place("name").textContent = name;
  place("state").textContent = job.state;
  place("state").className = `state ${job.state}`;
  place("watch").hidden = isExport || job.frames_done === 0;
  place("watch").href = `/watch/jobs/${id}`;
  place("cancel").hidden = FINAL.includes(job.state);
  place("retry").hidden = !["failed", "cancelled"].includes(job.state);
  place("delete").hidden = !FINAL.includes(job.state);
  showProgress(job);
  showFacts(job);
  place("exports").hidden = isExport || job.state !== "succeeded";
  place("problem").hidden = !job.problem;
  if (job.problem) place("problem").textContent = `${job.problem.title}: ${job.problem.detail}`;
  place("no-files").textContent = ["failed", "cancelled"].includes(job.state)
    ? "None: the job has not come to its end." : "Nothing yet: files appear when the job has succeeded.";
  if (job.state === "succeeded") await Promise.all([showFiles(), isExport ? null : showExports()]);
}

function showProgress(job) {
  const total = job.frames_total;
  place("bar").value = total ? job.frames_done / total : 0;
  const left = job.state === "running" ? secondsLeft(paced, total) : null;
  const said = left !== null ? `, ${duration(left)} left`
    : job.state === "running" && compiling ? ", compiling" : "";
  place("count").textContent = total ? `${job.frames_done} of ${total} frames${said}` : "";
}

/** What was asked for, as text: of a form of export its values, one after the other. */
function plain(value) {
  return value && typeof value === "object" ? Object.values(value).join(" ") : String(value);
}

function showFacts(job) {
  const facts = [["id", job.id], ["client", job.client], ["created", moment(job.created)],
    ["priority", job.priority], ["attempt", job.attempt]];
  const walk = (value, name) => {
    if (value === null || name === "priority") return undefined; // unsaid, or said above
    if (value && typeof value === "object" && !Array.isArray(value)) {
      if (name === "uploads") return facts.push(["files", Object.keys(value).length]);
      for (const [key, inner] of Object.entries(value)) walk(inner, key);
      return undefined;
    }
    if (name === "frames" && typeof value === "boolean") name = "PNG"; // beside those of the input
    return facts.push([name, Array.isArray(value) ? value.map(plain).join(", ") : plain(value)]);
  };
  walk(job.request, "request");
  place("facts").replaceChildren(...facts.flatMap(([key, value]) => [
    element("dt", {}, key), element("dd", {}, String(value))]));
}

let reportShown = false;

async function showFiles() {
  const files = await ask(`${here}/results`);
  const shown = files.slice(0, 60).map((file) => element("tr", {},
    element("td", {}, element("a", { href: file.url, download: file.name.split("/").at(-1) }, file.name)),
    element("td", { class: "number" }, bytes(file.size))));
  if (files.length > shown.length) {
    shown.push(element("tr", {}, element("td", { colspan: 2 }, `and ${files.length - shown.length} more, by the API`)));
  }
  place("files").replaceChildren(...shown);
  place("no-files").hidden = files.length > 0;
  if (files.length > 1) {
    const link = element("a", { href: `${here}/archive`, download: "" }, "all of them as ZIP");
    place("files").append(element("tr", {}, element("td", { colspan: 2 }, link)));
  }
  const report = files.find(({ name }) => name === "report.json");
  if (report && !reportShown) {
    reportShown = true;
    const said = await ask(report.url);
    if (!said.frames) return;
    place("report").hidden = false;
    place("plots").replaceChildren(...plotsOf(said));
    place("views").replaceChildren(...viewRows(said));
    const lines = [...(said.remarks ?? []), ...(said.warnings ?? [])];
    place("remarks").replaceChildren(...lines.map((line) => element("li", {}, line)));
  }
}

/** A link to what an export made: its one file, or all of them as ZIP. */
async function download(job, name) {
  const files = await ask(`/api/v1/jobs/${job.id}/results`);
  const href = files.length === 1 ? files[0].url : `/api/v1/jobs/${job.id}/archive`;
  return element("a", { class: "button", href, download: files.length === 1 ? files[0].name : "",
    "aria-label": `Download ${name}` }, "Download");
}

async function showExports() {
  const made = await ask(`${here}/exports`);
  const shown = await Promise.all(made.jobs.map(async (job) => {
    const name = formName(job.request.export);
    return element("li", { class: "row spread" },
      element("a", { href: `/jobs/${job.id}` }, name),
      job.state === "succeeded" ? await download(job, name) : stateOf(job.state));
  }));
  place("export-list").replaceChildren(...shown);
  if (made.jobs.some((job) => !FINAL.includes(job.state))) {
    setTimeout(() => trying(showExports), 1500);
  }
}

place("export").addEventListener("submit", (event) => {
  event.preventDefault();
  const data = new FormData(event.target);
  const kind = data.get("kind");
  const form = { layout: data.get("layout"), container: kind };
  if (kind === "hevc") Object.assign(form, { container: "mp4", codec: "hevc" });
  if (kind === "ffv1") Object.assign(form, { container: "mkv", codec: "ffv1" });
  if (kind === "png") Object.assign(form, { container: "mkv", video: false, frames: true });
  trying(async () => {
    await ask(`${here}/exports`, { method: "POST", body: form });
    await showExports();
  });
});

for (const action of ["cancel", "retry"]) {
  place(action).addEventListener("click", () => trying(async () => {
    await ask(`${here}/${action}`, { method: "POST" });
    follow();
    await refresh();
  }));
}
place("delete").addEventListener("click", () => trying(async () => {
  if (!window.confirm("Delete this job and its files?")) return;
  await ask(here, { method: "DELETE" });
  location.assign("/");
}));

// Events

/** What an event says, in words. */
function wordsOf({ kind, data }) {
  const words = {
    JobStarted: () => `${data.frames_total - data.frames_done} frames to come`,
    Compiling: () => "compiling, this once",
    FrameFinished: () => `frame ${data.frame_index} (${data.done} of ${data.total})`,
    SegmentFinished: () => `segment ${data.index + 1} of ${data.count}`,
    Joining: () => "joining",
    Warned: () => `warning: ${data.text}`,
    JobFinished: () => `computed in ${duration(data.seconds)}`,
  };
  return words[kind]?.() ?? kind;
}

let source = null;
let last = 0;
let due = null;

/** When the last frames of this attempt were done: enough for a steady pace, few enough to follow it. */
const PACED = 20;
let paced = [];

/** Whether the first frame of this attempt waits for kernels that are compiled. */
let compiling = false;

function pace({ at, kind, data }) {
  if (kind === "JobStarted") paced = [];
  if (["JobStarted", "Compiling", "FrameFinished"].includes(kind)) compiling = kind === "Compiling";
  if (kind === "FrameFinished") {
    paced = [...paced, { at: Date.parse(at), done: data.done }].slice(-PACED);
  }
}

function follow() {
  source?.close();
  source = new EventSource(`${here}/events?after=${last}`);
  const take = (event) => {
    const said = JSON.parse(event.data);
    if (said.sequence <= last) return;
    last = said.sequence;
    pace(said);
    place("log").prepend(element("tr", {},
      element("td", { class: "soft when" }, new Date(said.at).toLocaleTimeString()),
      element("td", {}, wordsOf(said))));
    while (place("log").children.length > 400) place("log").lastChild.remove();
    due ??= setTimeout(() => {
      due = null;
      trying(refresh);
    }, 400);
    if (FINAL.includes(said.kind)) source.close();
  };
  const kinds = ["queued", "running", "cancelling", ...FINAL, "JobStarted", "Compiling",
    "FrameFinished", "SegmentFinished", "Joining", "Warned", "JobFinished"];
  for (const kind of kinds) source.addEventListener(kind, take);
}

place("logs").href = `${here}/logs`;
trying(showLeave);
trying(refresh).then(follow);
