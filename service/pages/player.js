/** Brings a track into a video element: by HLS, or at the live edge through a WebSocket. */

import Hls from "/static/vendor/hls.light.min.js";

const EASY = 0.6; // seconds behind the edge that are good
const LATE = 3; // seconds behind after which we jump
const KEEP = 20; // seconds kept behind the place shown

/** Play HLS; return what can be closed, and tells which time of the video the element calls 0. */
export function playHls(video, address, { live, onTrouble }) {
  if (!Hls.isSupported()) {
    video.src = address; // where the browser plays HLS itself
    return { close: () => video.removeAttribute("src"), latency: () => NaN, begin: () => 0 };
  }
  const hls = new Hls({
    enableWorker: false, // a worker from a blob is not let in
    startPosition: live ? -1 : 0,
    backBufferLength: 60,
    maxBufferLength: 30,
  });
  hls.on(Hls.Events.ERROR, (_, { fatal, type, details }) => {
    if (!fatal) return;
    onTrouble(`The video stopped: ${details}. Trying again.`);
    if (type === Hls.ErrorTypes.MEDIA_ERROR) hls.recoverMediaError();
    else setTimeout(() => hls.loadSource(address), 2000);
  });
  let begin = 0; // of a window that has moved on, its first segment
  hls.on(Hls.Events.INIT_PTS_FOUND, (_, { initPTS, timescale }) => {
    begin = initPTS / timescale;
  });
  hls.loadSource(address);
  hls.attachMedia(video);
  return {
    close: () => hls.destroy(),
    latency: () => (live ? hls.latency : NaN),
    begin: () => begin,
  };
}

/** Play the live edge; return the same. */
export function playLive(video, path, { onTrouble, onEnd }) {
  const state = { closed: false, queue: [], buffer: null, media: null, socket: null, next: null };

  const pump = () => {
    const { buffer, queue } = state;
    if (state.closed || !buffer || buffer.updating || state.media.readyState !== "open") return;
    const ranges = buffer.buffered;
    if (ranges.length && video.currentTime - ranges.start(0) > 2 * KEEP) {
      buffer.remove(0, video.currentTime - KEEP);
      return;
    }
    const part = queue.shift();
    if (!part) return;
    if (part.codec) {
      buffer.changeType(`video/mp4; codecs="${part.codec}"`);
      pump();
      return;
    }
    try {
      buffer.appendBuffer(part.data);
    } catch (error) {
      if (error.name !== "QuotaExceededError") throw error;
      queue.unshift(part);
      buffer.remove(0, Math.max(0.1, video.currentTime - 1));
    }
  };

  const chase = () => {
    const ranges = video.buffered;
    if (!ranges.length || video.paused) return;
    const end = ranges.end(ranges.length - 1);
    const behind = end - video.currentTime;
    const inside = [...Array(ranges.length).keys()].some(
      (at) => ranges.start(at) <= video.currentTime && video.currentTime <= ranges.end(at));
    if (behind > LATE || behind < 0 || (!inside && behind > 0)) {
      video.currentTime = Math.max(ranges.start(ranges.length - 1), end - EASY / 2);
    }
    video.playbackRate = behind > 2 * EASY ? 1.1 : 1;
  };

  const begin = (codec) => {
    state.media = new MediaSource();
    video.src = URL.createObjectURL(state.media);
    state.media.addEventListener("sourceopen", () => {
      URL.revokeObjectURL(video.src);
      state.buffer = state.media.addSourceBuffer(`video/mp4; codecs="${codec}"`);
      state.buffer.addEventListener("updateend", () => {
        chase();
        pump();
      });
      pump();
    }, { once: true });
  };

  const connect = () => {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(`${scheme}//${location.host}${path}`);
    socket.binaryType = "arraybuffer";
    state.socket = socket;
    let ended = false;
    socket.onmessage = ({ data }) => {
      if (typeof data !== "string") {
        state.queue.push({ data });
        pump();
        return;
      }
      const said = JSON.parse(data);
      if (said.kind === "init" && state.media) state.queue.push({ codec: said.codec });
      else if (said.kind === "init") begin(said.codec);
      else if (said.kind === "end") {
        ended = true;
        finish();
      }
    };
    socket.onclose = () => {
      if (state.closed || ended) return;
      onTrouble("The connection was lost. Trying again.");
      state.next = setTimeout(connect, 2000);
    };
  };

  const finish = () => {
    if (state.queue.length || state.buffer?.updating) {
      state.next = setTimeout(finish, 50);
      return;
    }
    if (state.media?.readyState === "open") state.media.endOfStream();
    onEnd();
  };

  const timer = setInterval(chase, 500);
  connect();
  return {
    close: () => {
      state.closed = true;
      clearInterval(timer);
      clearTimeout(state.next);
      state.socket.close();
      video.removeAttribute("src");
      video.load();
      video.playbackRate = 1;
    },
    latency: () => {
      const ranges = video.buffered;
      return ranges.length ? ranges.end(ranges.length - 1) - video.currentTime : NaN;
    },
    begin: () => 0,
  };
}
