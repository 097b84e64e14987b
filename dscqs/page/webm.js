/** Takes a WebM file apart: the packets of its one video track, and what a decoder must know. */

const SEGMENT = 0x18538067;
const CLUSTER = 0x1f43b675;
const TRACKS = 0x1654ae6b;
const TRACK = 0xae;
const VIDEO = 0xe0;
const BLOCK_GROUP = 0xa0;
const BLOCK = 0xa1;
const SIMPLE_BLOCK = 0xa3;
const CODEC = 0x86;
const PRIVATE = 0x63a2;
const WIDTH = 0xb0;
const HEIGHT = 0xba;
const FRAME_NS = 0x23e383;
const CLUSTER_TIME = 0xe7;
const GOES_INTO = new Set([SEGMENT, CLUSTER, TRACKS, TRACK, VIDEO, BLOCK_GROUP]);

/**
 * Return {codec, width, height, frameMs, packets: [bytes]}; codec is a string of WebCodecs.
 *
 * @throws Error where the file is damaged or holds something else
 */
export function readWebm(bytes) {
  const found = { packets: [], times: [] };
  walk(bytes, 0, bytes.length, found);
  if (!found.codec || found.packets.length === 0) throw new Error("webm: no video in the file");
  return {
    codec: codecString(found),
    width: found.width,
    height: found.height,
    frameMs: frameDuration(found),
    packets: found.packets,
  };
}

function walk(bytes, start, end, found) {
  let at = start;
  while (at < end) {
    const id = number(bytes, at, true);
    const size = number(bytes, id.end, false);
    const from = size.end;
    const to = size.unknown ? end : from + size.value;
    if (to > end) throw new Error("webm: the file is cut short");
    if (GOES_INTO.has(id.value)) walk(bytes, from, to, found);
    else take(id.value, bytes.subarray(from, to), found);
    at = to;
  }
}

function take(id, content, found) {
  switch (id) {
    case CODEC:
      if (found.codec) throw new Error("webm: more than one track");
      found.codec = String.fromCharCode(...content).replace(/\0+$/, "");
      break;
    case PRIVATE:
      found.private = content;
      break;
    case WIDTH:
      found.width = unsigned(content);
      break;
    case HEIGHT:
      found.height = unsigned(content);
      break;
    case FRAME_NS:
      found.frameNs = unsigned(content);
      break;
    case CLUSTER_TIME:
      found.clusterMs = unsigned(content);
      break;
    case BLOCK:
    case SIMPLE_BLOCK: {
      const track = number(content, 0, false);
      const view = new DataView(content.buffer, content.byteOffset, content.length);
      if (content[track.end + 2] & 0x06) throw new Error("webm: laced blocks are not read");
      found.times.push(found.clusterMs + view.getInt16(track.end));
      found.packets.push(content.subarray(track.end + 3));
      break;
    }
    default:
  }
}

/** A number of EBML: {value, end, unknown}. */
function number(bytes, at, keepsMarker) {
  const first = bytes[at];
  if (!first) throw new Error("webm: not the structure of a WebM file");
  const length = Math.clz32(first) - 23;
  let value = keepsMarker ? first : first & (0xff >> length);
  let unknown = !keepsMarker && value === 0xff >> length;
  for (let i = 1; i < length; i++) {
    value = value * 256 + bytes[at + i];
    unknown = unknown && bytes[at + i] === 0xff;
  }
  return { value, end: at + length, unknown };
}

function unsigned(content) {
  return content.reduce((value, byte) => value * 256 + byte, 0);
}

function frameDuration({ frameNs, times }) {
  if (frameNs) return frameNs / 1e6;
  if (times.length < 2) return 40;
  return (Math.max(...times) - Math.min(...times)) / (times.length - 1);
}

function codecString({ codec, private: head, packets }) {
  if (codec === "V_VP9") {
    const first = packets[0][0];
    const profile = ((first >> 5) & 1) | ((first >> 3) & 2);
    return `vp09.0${profile}.62.08`;
  }
  if (codec === "V_AV1" && head?.length >= 4) {
    const level = String(head[1] & 31).padStart(2, "0");
    const depth = head[2] & 0x40 ? 10 : 8;
    return `av01.${head[1] >> 5}.${level}${head[2] & 0x80 ? "H" : "M"}.${String(depth).padStart(2, "0")}`;
  }
  throw new Error(`webm: codec ${codec} is neither VP9 nor AV1`);
}
