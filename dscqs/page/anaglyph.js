/**
 * The arithmetic of the anaglyph: whole numbers, so that every graphics processor gives the same.
 *
 * Dubois' least-squares matrices for red-cyan glasses, in thousandths, act on linear light of 20
 * bits; products and sums stay below 2^31.
 */

/** Linear light of full white. */
export const WHITE = 1048575;

/** Thousandths; rows: red, green, blue of the anaglyph; columns: red, green, blue of the eye. */
export const DUBOIS_LEFT = Object.freeze([437, 449, 164, -62, -62, -24, -48, -50, -17]);
export const DUBOIS_RIGHT = Object.freeze([-11, -32, -7, 377, 761, 9, -26, -93, 1234]);

function linearLight(value) {
  return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
}

/** Return the linear light of the 256 codes (sRGB), whole numbers of 0…WHITE. */
export function lightOfCodes() {
  return Int32Array.from({ length: 256 }, (_, code) => Math.round(WHITE * linearLight(code / 255)));
}

/** Return for each code the least light that is nearer to it, as displayed, than to the one below. */
export function leastLightOfCodes() {
  return Int32Array.from({ length: 256 }, (_, code) =>
    code === 0 ? 0 : Math.ceil(WHITE * linearLight((code - 0.5) / 255)),
  );
}
