/**
 * Where the pixels of two eyes go on a display, and when a browser cannot put them there.
 *
 * Pure functions of plain objects. "Signal": all device pixels that go to the display.
 * "Screen": what one eye sees of it, in pixels of the stimulus. Rows count from the top.
 */

/** Numbers of the modes in the shader; parts: screens side by side and above each other. */
export const MODES = Object.freeze({
  "mono-left": { code: 0, parts: [1, 1], squeeze: [1, 1] },
  "mono-right": { code: 1, parts: [1, 1], squeeze: [1, 1] },
  "sbs-full": { code: 2, parts: [2, 1], squeeze: [1, 1] },
  dual: { code: 2, parts: [2, 1], squeeze: [1, 1] },
  "sbs-half": { code: 3, parts: [2, 1], squeeze: [2, 1] },
  "tab-full": { code: 4, parts: [1, 2], squeeze: [1, 1] },
  "tab-half": { code: 5, parts: [1, 2], squeeze: [1, 2] },
  rows: { code: 6, parts: [1, 1], squeeze: [1, 1], interleaved: true },
  columns: { code: 7, parts: [1, 1], squeeze: [1, 1], interleaved: true },
  checkerboard: { code: 8, parts: [1, 1], squeeze: [1, 1], interleaved: true },
  anaglyph: { code: 9, parts: [1, 1], squeeze: [1, 1] },
  "frame-sequential": { code: 10, parts: [1, 1], squeeze: [1, 1] },
  webxr: { code: 1, parts: [1, 1], squeeze: [1, 1] },
});

/** Slowest refresh of shutter glasses that most people do not see flicker, Hz. */
export const LEAST_SEQUENTIAL_HZ = 100;

/** Return [width, height] of what one eye sees of the signal, in pixels of the stimulus. */
export function screenSize(profile) {
  const { parts, squeeze } = MODES[profile.mode];
  return [
    (profile.width_px / parts[0]) * squeeze[0],
    (profile.height_px / parts[1]) * squeeze[1],
  ];
}

/** Return where the top left pixel of an eye's picture lies on its screen: in the middle. */
export function placeEye(screen, eye) {
  return [Math.floor((screen[0] - eye[0]) / 2), Math.floor((screen[1] - eye[1]) / 2)];
}

/** Return the height of the screen as one eye sees it, mm; null where the pitch is not known. */
export function screenHeight(profile) {
  if (profile.pixel_pitch_mm === null || profile.pixel_pitch_mm === undefined) return null;
  return (profile.height_px / MODES[profile.mode].parts[1]) *
    (MODES[profile.mode].squeeze[1]) * profile.pixel_pitch_mm;
}

/** Return the viewing distance, mm; null where the pixel pitch is not known. */
export function viewingDistance(profile) {
  const height = screenHeight(profile);
  return height === null ? null : height * profile.distance_heights;
}

/**
 * Return why this browser cannot show the profile exactly: [] where it can.
 *
 * Each reason is {code, values}: code is a key of the texts, values fill its gaps. `seen` is what
 * was observed: {webgl2, largestTexture, canvas: [w, h] in device pixels, zoom of the visual
 * viewport, fullscreen, webxr, refreshHz}.
 */
export function refusals(profile, seen) {
  const found = [];
  const refuse = (code, values = {}) => found.push({ code, values });
  if (!seen.webgl2) refuse("no-webgl2");
  if (profile.mode === "webxr") {
    if (!seen.webxr) refuse("no-webxr");
    return found;
  }
  if (!seen.fullscreen) refuse("no-fullscreen");
  if (seen.zoom !== 1) refuse("pinched", { zoom: seen.zoom });
  if (seen.canvas === null) refuse("no-device-pixels", { ratio: seen.ratio });
  else if (seen.canvas[0] !== profile.width_px || seen.canvas[1] !== profile.height_px) {
    refuse("wrong-size", {
      is: `${seen.canvas[0]} × ${seen.canvas[1]}`,
      wanted: `${profile.width_px} × ${profile.height_px}`,
    });
  }
  if (profile.mode === "frame-sequential") {
    if (profile.eye_code === "none") refuse("no-eye-code");
    if (!(seen.refreshHz >= LEAST_SEQUENTIAL_HZ)) {
      refuse("slow-refresh", { is: seen.refreshHz.toFixed(1), wanted: LEAST_SEQUENTIAL_HZ });
    }
  }
  return found;
}

/** Return what may spoil the picture without our being able to tell: reasons as in `refusals`. */
export function warnings(profile, seen) {
  const found = [];
  if (!Number.isInteger(seen.ratio)) found.push({ code: "odd-ratio", values: { is: seen.ratio } });
  if (profile.pixel_pitch_mm === null) found.push({ code: "no-pitch", values: {} });
  if (!profile.calibrated) found.push({ code: "not-calibrated", values: {} });
  return found;
}

/** Return why a stimulus of eyes of this size cannot be shown unscaled: [] where it can. */
export function stimulusRefusals(profile, eye, largestTexture) {
  const screen = screenSize(profile);
  const found = [];
  if (profile.mode !== "webxr" && (eye[0] > screen[0] || eye[1] > screen[1])) {
    found.push({
      code: "stimulus-too-large",
      values: { is: `${eye[0]} × ${eye[1]}`, wanted: `${screen[0]} × ${screen[1]}` },
    });
  }
  if (Math.max(2 * eye[0], eye[1]) > largestTexture) {
    found.push({ code: "texture-too-large", values: { most: largestTexture } });
  }
  return found;
}
