/** The dashboard: what the service does, what waits, and the way in. */

import {
  ask, bytes, duration, element, jobName, moment, repeat, showLeave, stateOf, trying,
} from "./api.js";
import { chosen, dropped, sendAll } from "./upload.js";

const PAGE = 20;
const place = (id) => document.getElementById(id);
let shown = PAGE;

function showStatus(status) {
  const text = {
    queued: `${status.queue.queued} waiting`,
    running: status.queue.running + status.queue.cancelling,
    succeeded: status.queue.succeeded,
    failed: status.queue.failed,
    workers: `${status.workers.busy} of ${status.workers.total} busy`,
    load: status.load === null ? "–" : status.load.toFixed(2),
    cores: status.cores,
    free: `${bytes(status.disk.free)} free`,
    used: bytes(status.disk.used),
    quota: bytes(status.disk.quota),
    up: duration(status.seconds),
    version: status.version,
    health: status.ready ? "ready" : "not ready",
  };
  for (const [id, value] of Object.entries(text)) place(id).textContent = value;
  place("health").className = `state ${status.ready ? "ready" : "failed"}`;
  place("no-streams").hidden = status.streams.length > 0;
  showStreams(status.streams);
}

/** Keep the items of streams that are on air still, so that focus stays. */
function showStreams(streams) {
  const list = place("streams");
  const known = new Map([...list.children].map((item) => [item.dataset.name, item]));
  for (const stream of streams) {
    const item = known.get(stream.name) ?? list.appendChild(streamItem(stream));
    known.delete(stream.name);
    item.querySelector("img").src = `${pictureOf(stream)}?${stream.fragments}`;
    item.querySelector(".soft").textContent = numbersOf(stream);
  }
  for (const gone of known.values()) gone.remove();
}

const pictureOf = ({ name }) => `/api/v1/streams/${encodeURIComponent(name)}/watch/result/latest.jpg`;

function numbersOf({ viewers, fragments, silent_since: since }) {
  const said = `${viewers === 1 ? "1 viewer" : `${viewers} viewers`}, ${fragments} frames`;
  return since ? `${said}, silent since ${moment(since)}` : said;
}

function streamItem(stream) {
  const where = `/watch/streams/${encodeURIComponent(stream.name)}`;
  return element("li", { class: "job", "data-name": stream.name },
    element("img", { class: "thumb", alt: "" }),
    element("div", { class: "what" },
      element("a", { class: "name", href: where }, stream.name),
      element("span", { class: "soft small" })),
  );
}

/** One list item for each job, kept from one look to the next so that focus stays. */
const items = new Map();

function jobItem(job) {
  const known = items.get(job.id);
  const version = JSON.stringify([job.state, job.frames_done, job.compiling]);
  if (known?.version === version) return known.item;
  const name = jobName(job);
  const part = job.frames_total ? job.frames_done / job.frames_total : 0;
  const what = element("div", { class: "what" },
    element("span", {}, element("a", { class: "name", href: `/jobs/${job.id}` }, name), " ",
      stateOf(job.state)),
    element("span", { class: "soft small" }, whenOf(job)));
  if (job.state === "running" && job.frames_total) {
    what.append(element("progress", { max: 1, value: part, "aria-label": `Frames of ${name}` }));
  }
  if (job.problem) what.append(element("span", { class: "small" }, job.problem.detail));
  const item = element("li", { class: "job" }, thumbOf(job), what, actionsOf(job, name));
  if (known) known.item.replaceWith(item);
  items.set(job.id, { item, version });
  return item;
}

function thumbOf(job) {
  const empty = element("span", { class: "thumb" });
  if (job.frames_done > 0) {
    const pictured = job.request.of ?? job.id; // an export has the picture of its job
    const image = element("img", { class: "thumb", alt: "" });
    image.addEventListener("load", () => empty.replaceWith(image)); // it may be on its way
    image.src = `/api/v1/jobs/${pictured}/watch/result/latest.jpg?${job.frames_done}`;
  }
  return empty;
}

function whenOf(job) {
  const frames = job.frames_total ? `${job.frames_done} of ${job.frames_total} frames, ` : "";
  const begun = `${frames}${job.compiling ? "compiling, " : ""}${moment(job.created)}`;
  if (!job.finished || !job.started) return begun;
  return `${begun}, took ${duration((new Date(job.finished) - new Date(job.started)) / 1000)}`;
}

function actionsOf(job, name) {
  const actions = element("div", { class: "actions" });
  const add = (text, work) => {
    const button = element("button", { type: "button", "aria-label": `${text} ${name}` }, text);
    button.addEventListener("click", () => trying(async () => {
      await work();
      await refresh();
    }));
    actions.append(button);
  };
  const at = `/api/v1/jobs/${job.id}`;
  if (job.frames_done > 0 && !job.request.export) {
    actions.append(element("a", { class: "button", href: `/watch/jobs/${job.id}`,
      "aria-label": `Watch ${name}` }, "Watch"));
  }
  if (["queued", "running"].includes(job.state)) {
    add("Cancel", () => ask(`${at}/cancel`, { method: "POST" }));
  }
  if (["failed", "cancelled"].includes(job.state)) {
    add("Retry", () => ask(`${at}/retry`, { method: "POST" }));
  }
  return actions;
}

async function refresh() {
  const state = place("filter").value;
  const [status, page] = await Promise.all([
    ask("/api/v1/status"),
    ask(`/api/v1/jobs?limit=${shown}${state ? `&state=${state}` : ""}`),
  ]);
  showStatus(status);
  const list = place("jobs");
  const wanted = page.jobs.map(jobItem);
  for (const [id, { item }] of items) {
    if (!wanted.includes(item)) {
      item.remove();
      items.delete(id);
    }
  }
  wanted.forEach((item, at) => {
    if (list.children[at] !== item) list.insertBefore(item, list.children[at] ?? null);
  });
  place("empty").hidden = page.jobs.length > 0;
  place("more").hidden = !page.next;
}

// A new job

function requestOf(form) {
  const data = new FormData(form);
  const settings = ["magnification", "temporal"].filter((name) => data.get(name))
    .map((name) => [name, data.get(name)]);
  const range = data.get("range").trim();
  return {
    settings: Object.fromEntries(settings),
    input: {
      ...(range && { frames: range }),
      ...(data.get("input_layout") && { input_layout: data.get("input_layout") }),
    },
    output: {
      layout: data.get("layout"), container: data.get("container"),
      frames: data.has("frames"), master: data.has("master"),
      sound: data.has("sound") ? "copy" : "none",
      ...(data.get("codec") && { codec: data.get("codec") }),
    },
    priority: Number(data.get("priority") || 0),
  };
}

/** Offer the codecs that the chosen kind of file holds. */
function offerCodecs() {
  const { codec, container } = place("form").elements;
  for (const option of codec.options) {
    option.disabled = Boolean(option.value) && !option.dataset.in.split(" ").includes(container.value);
  }
  if (codec.selectedOptions[0].disabled) codec.value = "";
}

async function submit({ files, folder }) {
  if (!files.length || !place("form").reportValidity()) return;
  const request = { ...requestOf(place("form")), ...(folder && { name: folder }) };
  const stop = new AbortController();
  place("upload-stop").onclick = () => stop.abort();
  place("upload").hidden = false;
  place("drop").inert = true;
  const many = files.length === 1 ? files[0].name : `${files.length} files`;
  const onProgress = (sent, total) => {
    place("upload-bar").value = total ? sent / total : 1;
    place("upload-text").textContent = `Sending ${many}: ${bytes(sent)} of ${bytes(total)}`;
  };
  onProgress(0, 1);
  await trying(async () => {
    try {
      const uploads = await sendAll(files, { onProgress, signal: stop.signal });
      const job = await ask("/api/v1/jobs", {
        method: "POST", body: { ...request, uploads },
        headers: { "Idempotency-Key": crypto.randomUUID?.() ?? String(Math.random()) },
      });
      location.assign(`/jobs/${job.id}`);
    } catch (error) {
      if (error.name !== "AbortError") throw error;
    } finally {
      place("upload").hidden = true;
      place("drop").inert = false;
    }
  });
}

function listenForScenes() {
  const drop = place("drop");
  for (const name of ["dragenter", "dragover"]) {
    document.addEventListener(name, (event) => {
      event.preventDefault();
      drop.classList.add("over");
    });
  }
  document.addEventListener("dragleave", (event) => {
    if (!event.relatedTarget) drop.classList.remove("over");
  });
  document.addEventListener("drop", async (event) => {
    event.preventDefault();
    drop.classList.remove("over");
    await submit(await dropped(event.dataTransfer));
  });
  for (const [button, input] of [["choose-folder", "folder"], ["choose-files", "files"]]) {
    place(button).addEventListener("click", () => place(input).click());
    place(input).addEventListener("change", async () => {
      const scene = chosen(place(input).files);
      place(input).value = "";
      await submit(scene);
    });
  }
}

place("filter").addEventListener("change", () => trying(refresh));
place("more").addEventListener("click", () => {
  shown = Math.min(500, shown + 5 * PAGE);
  trying(refresh);
});
place("form").elements.container.addEventListener("change", offerCodecs);
offerCodecs();
listenForScenes();
trying(showLeave);
repeat(refresh, 2);
