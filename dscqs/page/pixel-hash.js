/** The hash of decoded pixels, the same as `dscqs.pixel_hash.hash_frames` computes. */

import { hex, sha256 } from "./sha256.js";

/** Adds frames in their order; `digest` gives the hash. */
export class PixelHash {
  #digests = [];

  /** Add a frame of planes, one after the other; order: indices of R, G, B among them. */
  async addPlanes(planes, order) {
    const count = planes.length / 3;
    const sorted = new Uint8Array(planes.length);
    order.forEach((from, to) => {
      sorted.set(planes.subarray(from * count, (from + 1) * count), to * count);
    });
    this.#digests.push(await sha256(sorted));
  }

  /** Add a frame of RGBA pixels. */
  async addPixels(pixels) {
    const count = pixels.length / 4;
    const planes = new Uint8Array(3 * count);
    for (let i = 0; i < count; i++) {
      planes[i] = pixels[4 * i];
      planes[count + i] = pixels[4 * i + 1];
      planes[2 * count + i] = pixels[4 * i + 2];
    }
    this.#digests.push(await sha256(planes));
  }

  /** Return 64 hexadecimal digits. */
  async digest() {
    const all = new Uint8Array(32 * this.#digests.length);
    this.#digests.forEach((digest, index) => all.set(digest, 32 * index));
    return hex(await sha256(all));
  }
}
