/** Numbers of a continuous scale: pure functions. */

export const LEAST = 0;
export const MOST = 100;
const MIDDLE = 50;

/** Return a grade as it is stored: 0…100 in steps of 0.1. */
export function rounded(value) {
  return Math.round(Math.min(MOST, Math.max(LEAST, value)) * 10) / 10;
}

/** Return the grade at a place of a line whose upper end is the best. */
export function gradeAt(y, top, height) {
  return rounded(MOST * (1 - (y - top) / height));
}

/**
 * Return the grade after a key, or null where the key means nothing here.
 *
 * The first key of a scale that has no grade yet puts the handle in the middle, or to an end.
 */
export function gradeAfterKey(value, key, isFine) {
  if (key === "Home") return LEAST;
  if (key === "End") return MOST;
  const step = {
    ArrowUp: isFine ? 0.1 : 1,
    ArrowRight: isFine ? 0.1 : 1,
    ArrowDown: isFine ? -0.1 : -1,
    ArrowLeft: isFine ? -0.1 : -1,
    PageUp: 10,
    PageDown: -10,
  }[key];
  if (step === undefined) return null;
  return value === null ? MIDDLE : rounded(value + step);
}

/** Return which fifth a grade lies in: 0 the best … 4 the worst. */
export function fifthOf(value) {
  return Math.min(4, Math.floor((MOST - value) / 20));
}
