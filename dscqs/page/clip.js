/**
 * Lossless video, frame by frame, as the planes G, B, R that the codec holds.
 *
 * The browser's own way from video to picture converts colours, and rounds. Here nothing is
 * converted: the stimuli are coded as RGB (identity matrix, 4:4:4), WebCodecs gives the planes as
 * they were coded, and the shader puts them together again. Another matrix or format is refused.
 */

import { PixelHash } from "./pixel-hash.js";
import { isRgbCoded } from "./rgb-coded.js";
import { readWebm } from "./webm.js";

/** Memory for the decoded frames of one clip, bytes; longer clips are decoded as they play. */
export const MEMORY = 768 * 2 ** 20;

/** Frames decoded ahead of the one that is shown, where not all are kept. */
const AHEAD = 12;

/** Packets that wait in the decoder. */
const QUEUE = 6;

/** Where R, G and B are among the planes of RGB video. */
const RGB_OF_GBR = Object.freeze([2, 0, 1]);

export class Clip {
  #frames = new Map();
  #isWhole = false;
  #wanted = 0;
  #decoder = null;
  #failed = null;

  /** @throws Error where the bytes are no WebM of VP9 or AV1, or there is no WebCodecs */
  constructor(bytes, { memory = MEMORY } = {}) {
    if (!("VideoDecoder" in globalThis)) {
      throw new Error("video needs WebCodecs: HTTPS or localhost, and a browser that has it");
    }
    this.file = readWebm(bytes);
    if (!isRgbCoded(this.file.codec, this.file.packets[0])) {
      throw new Error("video is not coded as RGB (gbrp): its colours would be converted");
    }
    this.size = 3 * this.file.width * this.file.height;
    this.#isWhole = this.size * this.file.packets.length <= memory;
  }

  get width() {
    return this.file.width;
  }

  get height() {
    return this.file.height;
  }

  get frameMs() {
    return this.file.frameMs;
  }

  get count() {
    return this.file.packets.length;
  }

  /** Tell whether every frame is in memory. */
  get isWhole() {
    return this.#isWhole;
  }

  /** Decode all once, and return the hash of the pixels; keeps the frames where they fit. */
  async verify() {
    const hash = new PixelHash();
    let count = 0;
    for await (const planes of this.#decode()) {
      await hash.addPlanes(planes, RGB_OF_GBR);
      if (this.#isWhole) this.#frames.set(count, planes);
      count += 1;
    }
    if (count !== this.count) throw new Error(`${this.count} packets gave ${count} frames`);
    return hash.digest();
  }

  /** Go to the first frame; resolves when the first frames are there. */
  async begin() {
    if (this.#isWhole) return;
    this.stop();
    this.#wanted = 0;
    const decoder = (this.#decoder = {});
    const ready = new Promise((resolve) => {
      this.#ready = resolve;
    });
    this.#run(decoder).catch((error) => {
      this.#failed = error;
      this.#ready();
    });
    await ready;
    if (this.#failed) throw this.#failed;
  }

  /** Return the planes of a frame, or null where it has not been decoded yet. */
  at(index) {
    if (!this.#isWhole) {
      this.#wanted = index;
      for (const kept of this.#frames.keys()) if (kept < index) this.#frames.delete(kept);
      this.#wake?.();
    }
    return this.#frames.get(index) ?? null;
  }

  /** Stop decoding. */
  stop() {
    this.#decoder = null;
    this.#wake?.();
    if (!this.#isWhole) this.#frames.clear();
  }

  #ready = () => {};
  #wake = null;

  async #run(mine) {
    let index = 0;
    for await (const planes of this.#decode()) {
      if (this.#decoder !== mine) return;
      this.#frames.set(index, planes);
      index += 1;
      if (index === Math.min(AHEAD, this.count)) this.#ready();
      while (this.#decoder === mine && index > this.#wanted + AHEAD) {
        await new Promise((resolve) => {
          this.#wake = resolve;
        });
      }
    }
  }

  /** Yield the planes of every frame. */
  async *#decode() {
    const output = [];
    let failed = null;
    let tell = () => {};
    const decoder = new VideoDecoder({
      output: (frame) => {
        output.push(frame);
        tell();
      },
      error: (error) => {
        failed = error;
        tell();
      },
    });
    try {
      decoder.configure({
        codec: this.file.codec,
        codedWidth: this.width,
        codedHeight: this.height,
        hardwareAcceleration: "prefer-software",
      });
      decoder.addEventListener("dequeue", () => tell());
      let sent = 0;
      let flushed = null;
      let isFlushed = false;
      while (true) {
        if (failed) throw failed;
        while (sent < this.count && decoder.decodeQueueSize < QUEUE && output.length < QUEUE) {
          decoder.decode(
            new EncodedVideoChunk({
              type: sent === 0 ? "key" : "delta",
              timestamp: Math.round(sent * this.frameMs * 1000),
              data: this.file.packets[sent],
            }),
          );
          sent += 1;
        }
        if (sent === this.count && flushed === null) {
          flushed = decoder.flush().then(
            () => {
              isFlushed = true;
              tell();
            },
            (error) => {
              failed = error;
              tell();
            },
          );
        }
        if (output.length > 0) {
          yield await this.#planes(output.shift());
        } else if (isFlushed) {
          return;
        } else {
          await new Promise((resolve) => {
            tell = resolve;
          });
        }
      }
    } finally {
      for (const frame of output) frame.close();
      if (decoder.state !== "closed") decoder.close();
    }
  }

  async #planes(frame) {
    try {
      const { format, visibleRect } = frame;
      if (format !== "I444") throw new Error(`video is ${format}, not three whole planes of 8 bits`);
      const { width, height } = visibleRect;
      if (width !== this.width || height !== this.height) {
        throw new Error(`a frame is ${width} × ${height}, not ${this.width} × ${this.height}`);
      }
      const planes = new Uint8Array(this.size);
      await frame.copyTo(planes, {
        layout: [0, 1, 2].map((plane) => ({ offset: plane * width * height, stride: width })),
      });
      return planes;
    } finally {
      frame.close();
    }
  }
}
