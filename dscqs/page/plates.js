/** Pseudo-isochromatic plates, drawn: digits of dots that differ from the ground in hue alone. */

import { pick, randomFrom } from "./random.js";

const SIZE = 480;
const TRIES = 9000;

/**
 * Colours in CIE L*a*b*. The first plate differs in lightness too: everybody reads it. The others
 * lie along the lines that red-green deficient eyes confuse, and lightness varies at random.
 */
const PLATES = Object.freeze([
  { figure: [38, 40, 40], ground: [72, -4, 16], spread: 5 },
  { figure: [58, 34, 34], ground: [58, -18, 38], spread: 12 },
  { figure: [58, -22, 30], ground: [58, 26, 30], spread: 12 },
  { figure: [60, 36, 8], ground: [60, -6, 8], spread: 12 },
  { figure: [56, -24, 8], ground: [56, 14, 8], spread: 12 },
  { figure: [58, 30, 22], ground: [58, -14, 22], spread: 12 },
]);

export const PLATE_COUNT = PLATES.length;

/** Wrong plates that still count as normal colour vision. */
export const WRONG_ALLOWED = 1;

/** Return the digits of a set of plates: no two neighbours alike. */
export function drawDigits(seed) {
  const random = randomFrom(seed);
  const digits = [];
  while (digits.length < PLATE_COUNT) {
    const digit = 2 + pick(random, 8);
    if (digit !== digits[digits.length - 1]) digits.push(digit);
  }
  return digits;
}

/** Draw one plate. */
export function drawPlate(canvas, index, digit, seed) {
  canvas.width = SIZE;
  canvas.height = SIZE;
  const random = randomFrom(seed);
  const context = canvas.getContext("2d");
  const isFigure = maskOf(digit);
  context.clearRect(0, 0, SIZE, SIZE);
  for (const { x, y, radius } of packDots(random)) {
    const { figure, ground, spread } = PLATES[index];
    const [lightness, a, b] = isFigure(x, y) ? figure : ground;
    const jitter = (random() - 0.5) * 2 * spread;
    context.fillStyle = rgbOf(lightness + jitter, a, b);
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.fill();
  }
}

/** Return dots in a round plate that do not overlap. */
function packDots(random) {
  const dots = [];
  for (let attempt = 0; attempt < TRIES; attempt++) {
    const x = random() * SIZE;
    const y = random() * SIZE;
    const fromEdge = SIZE / 2 - Math.hypot(x - SIZE / 2, y - SIZE / 2);
    let radius = Math.min(11, fromEdge);
    for (const dot of dots) {
      radius = Math.min(radius, Math.hypot(x - dot.x, y - dot.y) - dot.radius - 1);
      if (radius < 3) break;
    }
    if (radius >= 3) dots.push({ x, y, radius });
  }
  return dots;
}

function maskOf(digit) {
  const canvas = document.createElement("canvas");
  canvas.width = SIZE;
  canvas.height = SIZE;
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.font = `bold ${SIZE * 0.72}px sans-serif`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(String(digit), SIZE / 2, SIZE * 0.53);
  const { data } = context.getImageData(0, 0, SIZE, SIZE);
  return (x, y) => data[4 * (Math.floor(y) * SIZE + Math.floor(x)) + 3] > 127;
}

/** Return a CSS colour of L*a*b* (D65). */
function rgbOf(lightness, a, b) {
  const fy = (lightness + 16) / 116;
  const cube = (f) => (f > 6 / 29 ? f ** 3 : 3 * (6 / 29) ** 2 * (f - 4 / 29));
  const x = 0.95047 * cube(fy + a / 500);
  const y = cube(fy);
  const z = 1.08883 * cube(fy - b / 200);
  const linear = [
    3.2406 * x - 1.5372 * y - 0.4986 * z,
    -0.9689 * x + 1.8758 * y + 0.0415 * z,
    0.0557 * x - 0.204 * y + 1.057 * z,
  ];
  const codes = linear.map((value) => {
    const light = Math.min(1, Math.max(0, value));
    return Math.round(255 * (light <= 0.0031308 ? 12.92 * light : 1.055 * light ** (1 / 2.4) - 0.055));
  });
  return `rgb(${codes.join(" ")})`;
}
