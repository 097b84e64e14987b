/** Landolt rings: visual acuity from pixel pitch and distance. */

import { viewingDistance } from "./layout.js";

/** Decimal acuities, easiest first (steps of a tenth of a logarithm, ISO 8596). */
export const ACUITIES = Object.freeze([0.25, 0.32, 0.4, 0.5, 0.63, 0.8, 1, 1.25]);

/** Where the gap may be. */
export const DIRECTIONS = Object.freeze(["up", "right", "down", "left"]);

/** Smallest gap that pixels draw well. */
const FINEST_PX = 1.5;
const ARCMIN = Math.PI / 180 / 60;

/** Return the gap of an acuity in pixels, and whether the display shows it; null without pitch. */
export function gapOf(acuity, profile) {
  const distance = viewingDistance(profile);
  if (distance === null || profile.mode === "webxr") return null;
  const pixels = (distance * Math.tan(ARCMIN / acuity)) / profile.pixel_pitch_mm;
  return { pixels, isShown: pixels >= FINEST_PX };
}

/** Draw a ring on a canvas whose pixels are those of the screen. */
export function drawRing(canvas, gap, direction) {
  const side = Math.ceil(gap * 9);
  canvas.width = side;
  canvas.height = side;
  canvas.style.setProperty("width", `${side / devicePixelRatio}px`);
  canvas.style.setProperty("height", `${side / devicePixelRatio}px`);
  const context = canvas.getContext("2d");
  context.fillStyle = "#fff";
  context.fillRect(0, 0, side, side);
  context.translate(side / 2, side / 2);
  context.rotate(((DIRECTIONS.indexOf(direction) - 1) * Math.PI) / 2);
  context.strokeStyle = "#000";
  context.lineWidth = gap;
  context.beginPath();
  context.arc(0, 0, 2 * gap, 0, 2 * Math.PI);
  context.stroke();
  context.fillRect(0, -gap / 2, 3 * gap, gap);
}
