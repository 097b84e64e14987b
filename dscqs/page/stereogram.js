/** Random-dot stereograms with disparities finer than a pixel: pure functions. */

import { MODES, placeEye, screenSize, viewingDistance } from "./layout.js";
import { randomFrom } from "./random.js";

/** The ten levels, seconds of arc (Gadia 2014). */
export const LEVELS = Object.freeze([160, 100, 63, 50, 40, 32, 26, 20, 16, 12.5]);

/** Finest disparity that grey levels of 8 bits make reliably, in pixels of one eye. */
export const FINEST_PX = 0.1;

const WIDEST_PX = 1200;

const ARCSEC = Math.PI / 180 / 3600;
const DOT_PX = 3;
/** Part of the area that dots cover. */
const COVERED = 0.35;

/** Return how far apart the pixels are that one eye sees along a row, in pixels of the signal. */
export function pixelsApart(profile) {
  const { squeeze } = MODES[profile.mode];
  return ["columns", "checkerboard"].includes(profile.mode) ? 2 : squeeze[0];
}

/**
 * Return the disparity of an angle, in pixels of the stimulus, and whether the display shows it.
 *
 * {pixels, isShown}; null where pixel pitch is not known, or both eyes get the same.
 */
export function disparityOf(arcsec, profile) {
  const distance = viewingDistance(profile);
  if (distance === null || profile.mode.startsWith("mono") || profile.mode === "webxr") return null;
  const pitch = profile.pixel_pitch_mm;
  const pixels = (distance * Math.tan(arcsec * ARCSEC)) / pitch;
  return { pixels, isShown: pixels / pixelsApart(profile) >= FINEST_PX };
}

/**
 * Return both eyes' dots, side by side, RGBA of 2·width × height.
 *
 * Three squares in a row, the one with the index `front` in front of the others by `disparity`:
 * half of it to the right in the left eye, half of it to the left in the right eye. All dots
 * lie at random places between pixels, so that sharpness tells nothing.
 *
 * @returns Uint8ClampedArray
 */
export function makeStereogram({ width, height, front, disparity, seed }) {
  const random = randomFrom(seed);
  const light = [new Float32Array(width * height), new Float32Array(width * height)];
  const square = squareOf(width, height, front);
  const count = Math.round((COVERED * width * height) / DOT_PX ** 2);
  for (let dot = 0; dot < count; dot++) {
    const x = random() * (width + 2 * DOT_PX) - DOT_PX;
    const y = random() * (height + 2 * DOT_PX) - DOT_PX;
    const inFront = isInside(x + DOT_PX / 2, y + DOT_PX / 2, square);
    const shift = inFront ? disparity / 2 : 0;
    addDot(light[0], width, height, x + shift, y);
    addDot(light[1], width, height, x - shift, y);
  }
  return toPixels(light, width, height);
}

/** Return {left, top, side} of one of the three squares. */
export function squareOf(width, height, index) {
  const side = Math.round(Math.min(height * 0.6, width * 0.22));
  const middle = (width * (2 * index + 1)) / 6;
  return { left: Math.round(middle - side / 2), top: Math.round((height - side) / 2), side };
}

/** Return [width, height] of the picture of the three squares on a display, for one eye. */
export function pictureSize(profile) {
  const screen = screenSize(profile);
  const width = Math.min(WIDEST_PX, Math.floor(screen[0] * 0.9));
  return [width, Math.min(Math.round(width * 0.36), Math.floor(screen[1] * 0.7))];
}

/** Return which square is nearest to a place of one eye's screen: 0 its left edge, 1 its right. */
export function squareAt(place, profile) {
  const screen = screenSize(profile);
  const size = pictureSize(profile);
  const [left] = placeEye(screen, size);
  const square = Math.floor((3 * (place * screen[0] - left)) / size[0]);
  return Math.min(2, Math.max(0, square));
}

function isInside(x, y, { left, top, side }) {
  return x >= left && x < left + side && y >= top && y < top + side;
}

/** Add the part of each pixel that a square dot covers. */
function addDot(light, width, height, x, y) {
  const firstColumn = Math.max(0, Math.floor(x));
  const lastColumn = Math.min(width - 1, Math.floor(x + DOT_PX));
  const firstRow = Math.max(0, Math.floor(y));
  const lastRow = Math.min(height - 1, Math.floor(y + DOT_PX));
  for (let row = firstRow; row <= lastRow; row++) {
    const down = Math.min(row + 1, y + DOT_PX) - Math.max(row, y);
    for (let column = firstColumn; column <= lastColumn; column++) {
      const across = Math.min(column + 1, x + DOT_PX) - Math.max(column, x);
      light[row * width + column] += down * across;
    }
  }
}

/** White dots on black; light becomes codes by the sRGB curve, so that edges lie where they should. */
function toPixels(light, width, height) {
  const pixels = new Uint8ClampedArray(2 * width * height * 4);
  for (let eye = 0; eye < 2; eye++) {
    for (let row = 0; row < height; row++) {
      for (let column = 0; column < width; column++) {
        const value = Math.min(1, light[eye][row * width + column]);
        const code = value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055;
        const at = 4 * (row * 2 * width + eye * width + column);
        pixels[at] = pixels[at + 1] = pixels[at + 2] = Math.round(255 * code);
        pixels[at + 3] = 255;
      }
    }
  }
  return pixels;
}
