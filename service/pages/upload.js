/** Resumable uploads (tus 1.0), several files at once, with one bar for all. */

import { Problem, toLogin } from "./api.js";

const CHUNK = 8 << 20;
const AT_ONCE = 4;
const TRIES = 8;
const TUS = { "Tus-Resumable": "1.0.0" };

/** Send files by their relative names; return `{name: upload id}`. */
export async function sendAll(files, { onProgress, signal }) {
  const total = files.reduce((sum, { file }) => sum + file.size, 0);
  const sent = new Map();
  const ids = {};
  const tell = () => onProgress([...sent.values()].reduce((a, b) => a + b, 0), total);
  const waiting = [...files];
  const worker = async () => {
    for (let next = waiting.shift(); next; next = waiting.shift()) {
      const { name, file } = next;
      ids[name] = await send(name, file, signal, (at) => {
        sent.set(name, at);
        tell();
      });
    }
  };
  await Promise.all(Array.from({ length: Math.min(AT_ONCE, files.length) }, worker));
  return ids;
}

async function send(name, file, signal, onSent) {
  const place = await begin(name, file.size, signal);
  let at = 0;
  let failures = 0;
  while (at < file.size) {
    try {
      const chunk = file.slice(at, at + CHUNK);
      at = await append(place, at, chunk, signal, (done) => onSent(at + done));
      failures = 0;
    } catch (error) {
      failures += 1;
      if (signal.aborted || failures > TRIES || (error instanceof Problem && error.status < 500 &&
          ![408, 409, 429].includes(error.status))) throw error;
      await new Promise((go) => setTimeout(go, Math.min(10, 0.5 * 2 ** failures) * 1000));
      at = await offset(place, signal).catch(() => at);
    }
    onSent(at);
  }
  return place.split("/").at(-1);
}

async function begin(name, size, signal) {
  const coded = btoa(String.fromCharCode(...new TextEncoder().encode(name)));
  const answer = await fetch("/api/v1/uploads", {
    method: "POST",
    signal,
    headers: { ...TUS, "Upload-Length": String(size), "Upload-Metadata": `filename ${coded}` },
  });
  return (await checked(answer)).headers.get("Location");
}

async function offset(place, signal) {
  const answer = await checked(await fetch(place, { method: "HEAD", headers: TUS, signal }));
  return Number(answer.headers.get("Upload-Offset"));
}

async function checked(answer) {
  if (answer.status === 401) toLogin();
  if (!answer.ok) throw new Problem(answer.status, await answer.json().catch(() => ({})));
  return answer;
}

/** XMLHttpRequest, since fetch does not tell how much has gone. */
function append(place, at, chunk, signal, onSent) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("PATCH", place);
    for (const [key, value] of Object.entries(TUS)) request.setRequestHeader(key, value);
    request.setRequestHeader("Upload-Offset", String(at));
    request.setRequestHeader("Content-Type", "application/offset+octet-stream");
    request.upload.addEventListener("progress", (event) => onSent(event.loaded));
    request.addEventListener("load", () => {
      if (request.status === 204) resolve(Number(request.getResponseHeader("Upload-Offset")));
      else reject(new Problem(request.status, parsed(request.responseText)));
    });
    request.addEventListener("error", () => reject(new TypeError("the connection was lost")));
    request.addEventListener("abort", () => reject(new DOMException("stopped", "AbortError")));
    signal.addEventListener("abort", () => request.abort(), { once: true });
    request.send(chunk);
  });
}

function parsed(text) {
  try {
    return JSON.parse(text);
  } catch {
    return {};
  }
}

/** Return what was dropped, folders looked through: see {@link withoutFolder}. */
export async function dropped(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  if (!entries.length) return withoutFolder([...transfer.files].map((file) => ({ name: file.name, file })));
  const found = [];
  for (const entry of entries) await walk(entry, "", found);
  return withoutFolder(found);
}

async function walk(entry, above, found) {
  const name = above + entry.name;
  if (entry.name.startsWith(".")) return;
  if (entry.isFile) {
    const file = await new Promise((good, bad) => entry.file(good, bad));
    found.push({ name, file });
    return;
  }
  const reader = entry.createReader();
  for (;;) {
    const some = await new Promise((good, bad) => reader.readEntries(good, bad));
    if (!some.length) return;
    for (const child of some) await walk(child, `${name}/`, found);
  }
}

/** Return what was chosen: see {@link withoutFolder}. */
export function chosen(list) {
  const found = [...list].map((file) => ({ name: file.webkitRelativePath || file.name, file }));
  return withoutFolder(found.filter(({ name }) => !name.split("/").some((p) => p.startsWith("."))));
}

/** Return `{files: [{name, file}], folder}`: a scene's names begin below its own folder, if any. */
function withoutFolder(files) {
  const heads = new Set(files.map(({ name }) => name.split("/")[0]));
  if (heads.size !== 1 || !files.every(({ name }) => name.includes("/"))) return { files, folder: null };
  const [folder] = heads;
  return { files: files.map(({ name, file }) => ({ name: name.slice(folder.length + 1), file })), folder };
}
