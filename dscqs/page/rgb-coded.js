/**
 * Tells from the coded bytes whether video is RGB: browsers do not say so reliably.
 *
 * VP9: the colour space in the header of a key frame. AV1: the matrix in the sequence header.
 */

const VP9_RGB = 7;
const AV1_IDENTITY = 0;
const AV1_SEQUENCE = 1;

/** Tell whether the planes of the video are G, B, R; `packet` is its first. */
export function isRgbCoded(codec, packet) {
  return codec.startsWith("vp09") ? vp9ColourSpace(packet) === VP9_RGB : av1Matrix(packet) === AV1_IDENTITY;
}

/** Reads numbers of some bits. */
class Bits {
  constructor(bytes) {
    this.bytes = bytes;
    this.at = 0;
  }

  take(count) {
    let value = 0;
    for (let i = 0; i < count; i++, this.at++) {
      value = value * 2 + ((this.bytes[this.at >> 3] >> (7 - (this.at & 7))) & 1);
    }
    return value;
  }
}

function vp9ColourSpace(packet) {
  const bits = new Bits(packet);
  bits.take(2);
  const profile = bits.take(1) + 2 * bits.take(1);
  if (profile === 3) bits.take(1);
  const showExisting = bits.take(1);
  const isInter = bits.take(1);
  bits.take(2);
  if (showExisting || isInter || bits.take(24) !== 0x498342) return null;
  if (profile >= 2) bits.take(1);
  return bits.take(3);
}

function av1Matrix(packet) {
  const sequence = av1Sequence(packet);
  if (sequence === null) return null;
  const bits = new Bits(sequence);
  const profile = bits.take(3);
  bits.take(1);
  const isReduced = bits.take(1);
  if (isReduced) bits.take(5);
  else if (!skipOperatingPoints(bits)) return null;
  const widthBits = bits.take(4) + 1;
  const heightBits = bits.take(4) + 1;
  bits.take(widthBits + heightBits);
  if (!isReduced && bits.take(1)) bits.take(7);
  bits.take(3);
  if (!isReduced) skipTools(bits);
  bits.take(3);
  const isDeep = bits.take(1);
  if (profile === 2 && isDeep) bits.take(1);
  if (profile !== 1) bits.take(1);
  if (!bits.take(1)) return null;
  bits.take(16);
  return bits.take(8);
}

/** Return the sequence header among the units of a packet, or null. */
function av1Sequence(packet) {
  let at = 0;
  while (at < packet.length) {
    const head = packet[at];
    at += head & 4 ? 2 : 1;
    let size = packet.length - at;
    if (head & 2) {
      size = 0;
      for (let shift = 0; ; shift += 7) {
        const byte = packet[at];
        at += 1;
        size += (byte & 127) * 2 ** shift;
        if (!(byte & 128)) break;
      }
    }
    if (((head >> 3) & 15) === AV1_SEQUENCE) return packet.subarray(at, at + size);
    at += size;
  }
  return null;
}

/** Pass the operating points; false where there is timing information, which is not read. */
function skipOperatingPoints(bits) {
  if (bits.take(1)) return false;
  const hasDelay = bits.take(1);
  const count = bits.take(5) + 1;
  for (let point = 0; point < count; point++) {
    bits.take(12);
    if (bits.take(5) > 7) bits.take(1);
    if (hasDelay && bits.take(1)) bits.take(4);
  }
  return true;
}

function skipTools(bits) {
  bits.take(4);
  const hasOrder = bits.take(1);
  if (hasOrder) bits.take(2);
  const forced = bits.take(1) ? 2 : bits.take(1);
  if (forced > 0 && !bits.take(1)) bits.take(1);
  if (hasOrder) bits.take(3);
}
