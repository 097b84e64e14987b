/** Pictures for calibrating a display: both eyes side by side, drawn on a canvas. */

import { lightOfCodes } from "./anaglyph.js";

/** Names of the patterns, and what to look for. */
export const PATTERNS = Object.freeze({
  eyes:
    "Close one eye, then the other. The left eye sees LEFT, the right eye RIGHT. " +
    "If not: S exchanges the eyes.",
  phase:
    "With the right eye closed the whole screen is white, with the left eye closed black. " +
    "If there are stripes or it is the other way round: P shifts the lines by one.",
  crosstalk:
    "Close the right eye. Make both halves alike with the up and down keys: " +
    "what the left eye sees of the right eye's white is then measured.",
  steps:
    "Every step differs from its neighbours, the darkest and the brightest too. " +
    "If not: set brightness and contrast of the display.",
  pixels:
    "The field is of single pixels, black and white in turn. It must look evenly grey, " +
    "without stripes or waves; else something scales the picture.",
});

const LIGHT = lightOfCodes();

/** Return the part of the light of white that a grey has: what crosstalk it matches. */
export function lightOf(level) {
  return LIGHT[level] / LIGHT[255];
}

/** Return a canvas of 2·width × height with a pattern; `level` is the grey of the crosstalk patch. */
export function makePattern(name, { width, height, level = 0 }) {
  const canvas = document.createElement("canvas");
  canvas.width = 2 * width;
  canvas.height = height;
  const context = canvas.getContext("2d");
  const fill = (colour, x, y, w, h) => {
    context.fillStyle = colour;
    context.fillRect(x, y, w, h);
  };
  const grey = (code) => `rgb(${code} ${code} ${code})`;
  const half = Math.floor(width / 2);
  const drawing = {
    eyes: () => {
      fill(grey(90), 0, 0, 2 * width, height);
      context.fillStyle = grey(230);
      context.font = `600 ${Math.round(Math.min(height / 4, width / 6))}px sans-serif`;
      context.textAlign = "center";
      context.textBaseline = "middle";
      context.fillText("LEFT", width / 2, height * 0.4);
      context.fillText("RIGHT", 1.5 * width, height * 0.6);
    },
    phase: () => {
      fill("#fff", 0, 0, width, height);
      fill("#000", width, 0, width, height);
    },
    crosstalk: () => {
      fill("#000", 0, 0, 2 * width, height);
      fill(grey(level), half, 0, width - half, height);
      fill("#fff", width, 0, half, height);
    },
    steps: () => {
      const codes = [0, 4, 8, 16, 32, 64, 96, 128, 160, 192, 224, 240, 248, 252, 255];
      for (const eye of [0, width]) {
        codes.forEach((code, index) => {
          const from = Math.round((index * width) / codes.length);
          const to = Math.round(((index + 1) * width) / codes.length);
          fill(grey(code), eye + from, 0, to - from, height);
        });
      }
    },
    pixels: () => {
      const image = context.createImageData(2 * width, height);
      for (let y = 0; y < height; y++) {
        for (let x = 0; x < 2 * width; x++) {
          const code = ((x % width) + y) % 2 ? 255 : 0;
          image.data.set([code, code, code, 255], 4 * (y * 2 * width + x));
        }
      }
      context.putImageData(image, 0, 0);
    },
  };
  drawing[name]();
  return canvas;
}
