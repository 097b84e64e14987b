/** The sides of a presentation: fetched, checked, decoded and in graphics memory before it begins. */

import { Clip } from "./clip.js";
import { PixelHash } from "./pixel-hash.js";

/**
 * Return a side that is ready: {pixels, eye, count, frameMs, isWhole, begin, prepare, current,
 * rest, free}; `prepare(index)` gives the source of a frame or null, `current` the one before.
 *
 * @throws Error where the bytes cannot be decoded exactly
 */
export async function makeSide(drawing, { bytes, type }, options = {}) {
  return type?.startsWith("video/")
    ? makeVideo(drawing, bytes, options)
    : makeStill(drawing, bytes, type);
}

async function makeStill(drawing, bytes, type) {
  const bitmap = await createImageBitmap(new Blob([bytes], { type: type ?? "image/png" }), {
    colorSpaceConversion: "none",
    premultiplyAlpha: "none",
  });
  if (bitmap.width % 2) throw new Error(`a width of ${bitmap.width} is not two equal eyes`);
  const source = drawing.fromPicture(bitmap, { stereo: true });
  bitmap.close();
  const hash = new PixelHash();
  await hash.addPixels(drawing.readSource(source));
  return {
    pixels: await hash.digest(),
    eye: source.eye,
    count: 1,
    frameMs: Infinity,
    isWhole: true,
    current: source,
    begin: async () => {},
    prepare: () => source,
    rest: () => {},
    free: () => drawing.free(source),
  };
}

async function makeVideo(drawing, bytes, options) {
  const clip = new Clip(bytes, options);
  if (clip.width % 2) throw new Error(`a width of ${clip.width} is not two equal eyes`);
  const pixels = await clip.verify();
  const source = drawing.forPlanes(clip.width, clip.height, { stereo: true });
  return {
    pixels,
    eye: source.eye,
    count: clip.count,
    frameMs: clip.frameMs,
    isWhole: clip.isWhole,
    current: source,
    begin: () => clip.begin(),
    prepare: (index) => {
      const planes = clip.at(index);
      if (planes === null) return null;
      drawing.fill(source, planes);
      return source;
    },
    rest: () => clip.stop(),
    free: () => {
      clip.stop();
      drawing.free(source);
    },
  };
}
