/** The page of a job or stream that is watched. */

import { ask, duration, element, jobName, moment, repeat, showLeave, trying } from "./api.js";
import { playHls, playLive } from "./player.js";
import { frameFacts, plotsOf } from "./report.js";
import { StereoView } from "./stereo-view.js";

const [, , kind, id] = location.pathname.split("/");
const here = `/api/v1/${kind}/${id}`;
const place = (name) => document.getElementById(name);
const videos = { result: place("result"), before: place("before") };
const view = new StereoView(place("canvas"));
const players = {};
let seen = null;
let report = null;
let drawn = 0;
let shownFrame = null;
let way = null;
let looking = null;

/** What works on a video only; pictures come as they are, both eyes side by side. */
const OF_VIDEO = ["looks", "swap", "play", "seek", "back-frame", "next-frame"];

/** Milliseconds until the picture that was sought is looked for again. */
const LOOK_AGAIN = 100;
const TRIES = 100;

window.depthsrWatch = { view, videos, numbers: () => ({ drawn, shownFrame, way }) };

// Drawing

function follow(name) {
  const video = videos[name];
  if (!video.requestVideoFrameCallback) {
    video.addEventListener("timeupdate", () => show(name));
    return;
  }
  const next = () => {
    show(name);
    video.requestVideoFrameCallback(next);
  };
  video.requestVideoFrameCallback(next);
}

/** The picture that a video holds now, which knows its own time; null where it holds none. */
function standing(video) {
  if (!window.VideoFrame) return { image: video, time: null, close: () => {} };
  try {
    const image = new VideoFrame(video);
    return { image, time: image.timestamp / 1e6, close: () => image.close() };
  } catch {
    return null;
  }
}

/** Which time of a video its element calls 0, seconds. */
const beginOf = (name) => players[name]?.begin() ?? 0;

/** Draw what videos hold; the number that is said is that of the very pictures drawn. */
function show(name) {
  if (!view.works || !videos[name].videoWidth || !seen.tracks.result) return;
  const picture = standing(videos[name]);
  if (!picture) return;
  view.take(name, picture.image,
    picture.time === null ? null : Math.round((picture.time + beginOf(name)) * seen.tracks.result.fps));
  picture.close();
  if (name === "result") {
    drawn += 1;
    if (!seen.silent_since) place("message").hidden = true;
  }
  keepTogether();
  draw();
}

function draw() {
  view.draw();
  showTags();
  shownFrame = view.shownFrame;
  if (players.result) showPlace();
}

/** Let the compared picture show the same frame. */
function keepTogether() {
  const { result, before } = videos;
  if (!players.before || !before.readyState || before.seeking || !seen.tracks.result) return;
  const frame = 1 / (seen.tracks.result.fps || 25);
  // Who goes to the very end at once is given no picture.
  const there = result.currentTime + beginOf("result") - beginOf("before");
  const wanted = Math.min(there, (before.duration || Infinity) - frame / 2);
  const apart = before.currentTime - wanted;
  if (result.paused || Math.abs(apart) > 0.5) {
    if (!before.paused) before.pause();
    if (Math.abs(apart) > frame / 4) before.currentTime = wanted;
    if (!result.paused) before.play().catch(() => {});
    return;
  }
  if (before.paused) before.play().catch(() => {});
  before.playbackRate = result.playbackRate * (Math.abs(apart) > frame / 2 ? 1 - apart / 2 : 1);
}

// Delivery

function shut(name) {
  players[name]?.close();
  delete players[name];
  view.forget(name);
}

function open(name) {
  shut(name);
  const track = seen.tracks[name];
  if (!track) return;
  const onTrouble = (text) => {
    place("message").textContent = text;
    place("message").hidden = false;
  };
  const isStream = kind === "streams";
  players[name] = way === "live" && track.live
    ? playLive(videos[name], track.live, { onTrouble, onEnd: () => trying(look) })
    : playHls(videos[name], track.playlist, { live: isStream, onTrouble });
}

function begin(chosen) {
  way = chosen;
  const stills = way === "stills";
  shownFrame = null;
  place("time").textContent = "";
  facts(place("frame"), []);
  place("stills").hidden = !stills;
  place("canvas").hidden = stills;
  // An address whose pictures have ended is not asked for again.
  const pictures = stills && seen.tracks.result?.stills;
  place("stills").src = pictures ? `${pictures}?at=${Date.now()}` : "";
  for (const id of OF_VIDEO) place(id).disabled = stills;
  for (const name of ["result", "before"]) shut(name);
  if (!stills) open("result");
  choose({});
  if (stills) place("message").hidden = !silent;
  else play(true);
}

function play(wanted) {
  const video = videos.result;
  if (wanted) video.play().catch(() => showPlaying());
  else video.pause();
}

function showPlaying() {
  const playing = !videos.result.paused;
  place("play").textContent = playing ? "Pause" : "Play";
  if (players.before) {
    if (playing) videos.before.play().catch(() => {});
    else videos.before.pause();
    keepTogether();
  }
}

// What there is

async function look() {
  const fresh = await ask(`${here}/watch`);
  const isNew = (name) => fresh.tracks[name]
    && fresh.tracks[name].broadcast !== seen?.tracks[name]?.broadcast;
  const [result, before] = [isNew("result"), isNew("before")];
  seen = fresh;
  view.describe(seen.tracks, seen.sampling);
  place("state").textContent = seen.state;
  place("state").className = `state ${seen.state}`;
  showSilence();
  const live = document.querySelector('[name="way"][value="live"]');
  live.disabled = !seen.tracks.result?.live;
  if (result || before) {
    document.querySelector('[name="mode"][value="compare"]').disabled = !seen.tracks.before;
  }
  if (result) {
    const wanted = way ?? (kind === "streams" ? "live" : "hls");
    document.querySelector(`[name="way"][value="${wanted}"]`).checked = true;
    begin(wanted);
  } else if (before) {
    shut("before");
    choose({});
  }
  if (!seen.tracks.result) {
    place("message").textContent = seen.state === "ended" ? "There is nothing to watch." : "Waiting for the first second of video…";
  }
  if (kind === "jobs" && seen.state === "ended" && !report) {
    report = {};
    const files = await ask(`${here}/results`);
    const file = files.find(({ name }) => name === "report.json");
    if (file) report = await ask(file.url);
    place("plots").replaceChildren(...plotsOf(report).slice(0, 2));
    place("frame-panel").hidden = !report.frames;
    if (players.result) showPlace(); // of what stands still, no other picture may come
  }
  showNumbers();
}

let silent = null;

/** Say over the last picture that no more come, as long as none do. */
function showSilence() {
  if (silent === seen.silent_since) return;
  silent = seen.silent_since;
  place("message").hidden = !silent;
  if (silent) place("message").textContent = `Nothing has arrived since ${moment(silent)}.`;
}

function facts(list, items) {
  list.replaceChildren(...items.flatMap(([key, value]) => [
    element("dt", {}, key), element("dd", {}, String(value))]));
}

let before = { drawn: 0, at: performance.now() };

function showNumbers() {
  const track = seen?.tracks.result;
  if (!track) return;
  const now = performance.now();
  const rate = (1000 * (drawn - before.drawn)) / (now - before.at);
  before = { drawn, at: now };
  const quality = videos.result.getVideoPlaybackQuality?.();
  const late = players.result?.latency();
  facts(place("numbers"), [
    ["one eye", `${track.eye_width} × ${track.eye_height}`],
    ["frames a second", `${track.fps.toFixed(2)}, shown ${rate.toFixed(1)}`],
    ["codec", track.codec],
    ["frames there", track.frames === null ? "–" : `${track.frames} of ${seen.frames_total ?? "?"}`],
    ["dropped", quality ? `${quality.droppedVideoFrames} of ${quality.totalVideoFrames}` : "–"],
    ["behind the edge", Number.isFinite(late) ? `${late.toFixed(1)} s` : "–"],
    ["enlarged from", seen.tracks.before ? `${seen.tracks.before.eye_width} × ${seen.tracks.before.eye_height}` : "–"],
  ]);
}

function showPlace() {
  const video = videos.result;
  const track = seen.tracks.result;
  const end = Number.isFinite(video.duration) ? video.duration
    : video.seekable.length ? video.seekable.end(video.seekable.length - 1) : 0;
  const seek = place("seek");
  seek.max = end;
  if (document.activeElement !== seek || !video.paused) seek.value = video.currentTime;
  seek.setAttribute("aria-valuetext", `${duration(video.currentTime)} of ${duration(end)}`);
  const time = shownFrame === null ? video.currentTime : shownFrame / track.fps - beginOf("result");
  const number = shownFrame === null ? "" : ` · frame ${track.first_frame + shownFrame}`;
  place("time").textContent = `${duration(time)} / ${duration(end)}${number}`;
  if (report?.frames && shownFrame !== null) facts(place("frame"), frameFacts(report, track.first_frame + shownFrame));
}

// Controls

function choose(changes) {
  Object.assign(view.options, changes);
  const { mode } = view.options;
  const stills = way === "stills";
  place("compare-tools").hidden = mode !== "compare" || stills;
  place("half").disabled = !["sbs", "tab"].includes(mode) || stills;
  if (mode === "compare" && !players.before && !stills) open("before");
  if (mode !== "compare" && players.before) shut("before");
  if (mode === "compare") keepTogether();
  draw();
}

/** Say which half is what, where there are two. */
function showTags() {
  const both = view.options.mode === "compare" && view.hasBefore;
  place("tag-one").hidden = !both;
  place("tag-two").hidden = !both;
}

for (const input of document.querySelectorAll('[name="mode"]')) {
  input.addEventListener("change", () => choose({ mode: input.value }));
}
for (const input of document.querySelectorAll('[name="way"]')) {
  input.addEventListener("change", () => begin(input.value));
}
place("half").addEventListener("change", () => choose({ half: place("half").checked }));
place("swap").addEventListener("change", () => choose({ swap: place("swap").checked }));
place("wipe").addEventListener("input", () => choose({ wipe: Number(place("wipe").value) }));
place("zoom").addEventListener("change", () => choose({ zoom: Number(place("zoom").value) }));
place("eye").addEventListener("change", () => choose({ eye: place("eye").value }));
place("play").addEventListener("click", () => play(videos.result.paused));
place("seek").addEventListener("input", () => {
  videos.result.currentTime = Number(place("seek").value);
});
place("canvas").addEventListener("pointermove", (event) => {
  if (view.options.mode !== "compare") return;
  const box = place("canvas").getBoundingClientRect();
  const x = (event.clientX - box.left) / box.width;
  if (event.buttons) place("wipe").value = x;
  choose({ wipe: Number(place("wipe").value), centre: event.buttons
    ? view.options.centre : [x, (event.clientY - box.top) / box.height] });
});
for (const name of ["play", "pause", "ended"]) videos.result.addEventListener(name, showPlaying);

/** Show the picture that was sought: a busy machine puts it there late, and may call no frame. */
function showSought(tries = TRIES) {
  if (!seen.tracks.result) return; // a stream that has been stopped
  const video = videos.result;
  const at = video.currentTime + beginOf("result");
  const sought = Math.floor(at * seen.tracks.result.fps + 1e-3) - (video.ended ? 1 : 0);
  for (const name of Object.keys(players)) show(name);
  clearTimeout(looking);
  if (!video.paused || shownFrame === null || shownFrame === sought) return;
  if (!tries) {
    view.forget("before"); // it holds another frame
    draw();
    return;
  }
  looking = setTimeout(() => showSought(tries - 1), LOOK_AGAIN);
}
for (const name of ["seeked", "ended"]) videos.result.addEventListener(name, () => showSought());
for (const name of ["loadeddata", "seeked"]) {
  videos.before.addEventListener(name, () => {
    show("before");
    keepTogether(); // also where there is no picture yet
  });
}

function step(frames) {
  if (!seen?.tracks.result) return;
  videos.result.pause();
  const { fps } = seen.tracks.result;
  const begin = beginOf("result");
  const from = shownFrame ?? Math.floor((videos.result.currentTime + begin) * fps);
  videos.result.currentTime = Math.max(0, (from + frames + 0.5) / fps - begin);
}
place("back-frame").addEventListener("click", () => step(-1));
place("next-frame").addEventListener("click", () => step(1));
place("full").addEventListener("click", () => {
  if (document.fullscreenElement) document.exitFullscreen();
  else place("stage").requestFullscreen().catch(() => {});
});

const KEYS = {
  " ": () => play(videos.result.paused),
  k: () => play(videos.result.paused),
  ArrowLeft: () => { videos.result.currentTime -= 2; },
  ArrowRight: () => { videos.result.currentTime += 2; },
  ",": () => step(-1),
  ".": () => step(1),
  f: () => place("full").click(),
  h: () => place("half").click(),
  s: () => place("swap").click(),
};
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.target.matches("input, select, button, a, summary")) return;
  const modes = [...document.querySelectorAll('[name="mode"]')];
  const number = Number(event.key);
  if (number >= 1 && number <= modes.length) modes[number - 1].click();
  else if (KEYS[event.key]) KEYS[event.key]();
  else return;
  event.preventDefault();
});

// Begin

if (!view.works) {
  place("message").textContent = "This browser cannot draw (WebGL 2 is missing): choose Pictures.";
}
follow("result");
follow("before");
trying(showLeave);
trying(async () => {
  if (kind === "jobs") {
    const job = await ask(here);
    place("name").textContent = jobName(job);
    place("back").href = `/jobs/${id}`;
  } else {
    place("name").textContent = decodeURIComponent(id);
    place("back").textContent = "Dashboard";
    place("back").href = "/";
  }
  document.title = `depthsr: watch ${place("name").textContent}`;
});
repeat(look, 2);
