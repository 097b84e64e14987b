/** Random numbers from a seed (mulberry32), and seeds that nobody can foresee. */

export function randomFrom(seed) {
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let mixed = Math.imul(state ^ (state >>> 15), state | 1);
    mixed ^= mixed + Math.imul(mixed ^ (mixed >>> 7), mixed | 61);
    return ((mixed ^ (mixed >>> 14)) >>> 0) / 2 ** 32;
  };
}

export function freshSeed() {
  return crypto.getRandomValues(new Uint32Array(1))[0];
}

/** Return a whole number of 0…count − 1. */
export function pick(random, count) {
  return Math.floor(random() * count);
}
