/** Draws one stereo source for a display, pixel by pixel, with WebGL 2. */

import { DUBOIS_LEFT, DUBOIS_RIGHT, leastLightOfCodes, lightOfCodes } from "./anaglyph.js";
import { MODES, placeEye, screenSize } from "./layout.js";
import { COVER, displayShader } from "./shaders.js";

const CONTEXT = Object.freeze({
  alpha: false,
  antialias: false,
  depth: false,
  stencil: false,
  preserveDrawingBuffer: false,
  powerPreference: "high-performance",
  xrCompatible: false,
});

/** Units of the textures. */
const PICTURE = 0;
const PLANES = 1;
const LIGHT = 2;

/**
 * The pictures that can be drawn: {texture, planar, stereo, eye: [width, height]}.
 *
 * `stereo` sources hold both eyes side by side, left first; others show the same to both eyes.
 */
export class StereoDrawing {
  /**
   * @param canvas the canvas; its width and height are set to the profile's signal
   * @param profile the display
   * @throws Error where WebGL 2 is missing
   */
  constructor(canvas, profile) {
    const forHeadset = profile.mode === "webxr";
    const gl = canvas.getContext("webgl2", { ...CONTEXT, xrCompatible: forHeadset });
    if (gl === null) throw new Error("WebGL 2 is not available");
    this.gl = gl;
    this.canvas = canvas;
    this.programs = new Map();
    this.setProfile(profile);
    this.light = makeLightTable(gl);
    gl.bindVertexArray(gl.createVertexArray());
    gl.disable(gl.DITHER);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
    gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, false);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.pixelStorei(gl.PACK_ALIGNMENT, 1);
  }

  /** Draw for this display from now on. */
  setProfile(profile) {
    this.profile = profile;
    if (this.canvas.width !== profile.width_px) this.canvas.width = profile.width_px;
    if (this.canvas.height !== profile.height_px) this.canvas.height = profile.height_px;
    const { code } = MODES[profile.mode];
    if (!this.programs.has(code)) {
      const program = makeProgram(this.gl, COVER, displayShader(code));
      this.programs.set(code, { program, at: uniformsOf(this.gl, program) });
    }
    this.current = this.programs.get(code);
  }

  get largestTexture() {
    return this.gl.getParameter(this.gl.MAX_TEXTURE_SIZE);
  }

  /** Return a source of an ImageBitmap or canvas. */
  fromPicture(picture, { stereo }) {
    const { gl } = this;
    const texture = makeTexture(gl, gl.TEXTURE_2D, PICTURE);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, picture);
    const eye = [stereo ? picture.width / 2 : picture.width, picture.height];
    return { texture, planar: false, stereo, eye };
  }

  /** Return a source to be filled with planes G, B, R of width × height. */
  forPlanes(width, height, { stereo }) {
    const { gl } = this;
    const texture = makeTexture(gl, gl.TEXTURE_2D_ARRAY, PLANES);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.R8, width, height, 3);
    return { texture, planar: true, stereo, eye: [stereo ? width / 2 : width, height] };
  }

  /** Put the planes of one frame, one after the other, into a source of `forPlanes`. */
  fill(source, planes) {
    const { gl } = this;
    const width = source.stereo ? 2 * source.eye[0] : source.eye[0];
    gl.activeTexture(gl.TEXTURE0 + PLANES);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, source.texture);
    gl.texSubImage3D(
      gl.TEXTURE_2D_ARRAY, 0, 0, 0, 0, width, source.eye[1], 3, gl.RED, gl.UNSIGNED_BYTE, planes,
    );
  }

  /** Give the memory of a source back. */
  free(source) {
    this.gl.deleteTexture(source.texture);
  }

  /**
   * Draw; what was drawn is on the screen at its next refresh.
   *
   * @param source what, or null for the surround alone
   * @param surround [red, green, blue] of 0…255
   * @param turn whose frame it is on a frame-sequential display: 0 left, 1 right
   */
  draw(source, surround, turn = 0) {
    const { gl, profile } = this;
    const { program, at } = this.current;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.useProgram(program);
    setSource(gl, at, source, surround, screenSize(profile), profile.swap);
    gl.uniform2i(at.signal, this.canvas.width, this.canvas.height);
    gl.uniform1i(at.phase, profile.phase);
    gl.uniform1i(at.turn, turn);
    gl.uniform1i(at.blueLine, profile.eye_code === "blue-line" ? 1 : 0);
    if (at.light !== undefined) {
      gl.activeTexture(gl.TEXTURE0 + LIGHT);
      gl.bindTexture(gl.TEXTURE_2D, this.light);
      gl.uniform1i(at.light, LIGHT);
      gl.uniform3iv(at["duboisLeft[0]"], DUBOIS_LEFT);
      gl.uniform3iv(at["duboisRight[0]"], DUBOIS_RIGHT);
    }
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** Draw each source once, unseen, and wait: what a driver does at first use is done then. */
  warmUp(sources, surround) {
    for (const source of [...sources, null]) this.draw(source, surround);
    this.gl.readPixels(0, 0, 1, 1, this.gl.RGBA, this.gl.UNSIGNED_BYTE, new Uint8Array(4));
  }

  /** Return the pixels that were drawn last, RGBA, rows from the top; call right after `draw`. */
  read() {
    const { width, height } = this.canvas;
    const pixels = new Uint8Array(width * height * 4);
    this.gl.readPixels(0, 0, width, height, this.gl.RGBA, this.gl.UNSIGNED_BYTE, pixels);
    return flipRows(pixels, width * 4);
  }

  /** Return the pixels of a source as the graphics memory holds them, RGBA, rows from the top. */
  readSource(source) {
    const { gl } = this;
    const width = source.stereo ? 2 * source.eye[0] : source.eye[0];
    const framebuffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.framebufferTexture2D(
      gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, source.texture, 0,
    );
    const pixels = new Uint8Array(width * source.eye[1] * 4);
    gl.readPixels(0, 0, width, source.eye[1], gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(framebuffer);
    return pixels;
  }
}

/** Set the uniforms that the shaders of displays and headsets share. */
export function setSource(gl, at, source, surround, screen, swapped) {
  const eye = source === null ? [0, 0] : source.eye;
  if (source !== null) {
    gl.activeTexture(gl.TEXTURE0 + (source.planar ? PLANES : PICTURE));
    gl.bindTexture(source.planar ? gl.TEXTURE_2D_ARRAY : gl.TEXTURE_2D, source.texture);
  }
  gl.uniform1i(at.picture, PICTURE);
  gl.uniform1i(at.planes, PLANES);
  gl.uniform1i(at.planar, source !== null && source.planar ? 1 : 0);
  gl.uniform1i(at.stereo, source !== null && source.stereo ? 1 : 0);
  gl.uniform1i(at.filled, source === null ? 1 : 0);
  gl.uniform1i(at.swapped, swapped ? 1 : 0);
  gl.uniform2i(at.eyeSize, ...eye);
  gl.uniform2i(at.origin, ...placeEye(screen, eye));
  gl.uniform3i(at.surround, ...surround);
}

/** Return a linked program; the error holds the compiler's words. */
export function makeProgram(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, source] of [
    [gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, fragment],
  ]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
      throw new Error(`shader: ${gl.getShaderInfoLog(shader)}`);
    }
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(`shaders: ${gl.getProgramInfoLog(program)}`);
  }
  return program;
}

/** Return the places of a program's uniforms by their names. */
export function uniformsOf(gl, program) {
  const count = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS);
  return Object.fromEntries(
    Array.from({ length: count }, (_, index) => {
      const { name } = gl.getActiveUniform(program, index);
      return [name, gl.getUniformLocation(program, name)];
    }),
  );
}

function makeTexture(gl, target, unit) {
  const texture = gl.createTexture();
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(target, texture);
  for (const [name, value] of [
    [gl.TEXTURE_MIN_FILTER, gl.NEAREST],
    [gl.TEXTURE_MAG_FILTER, gl.NEAREST],
    [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE],
    [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
  ]) {
    gl.texParameteri(target, name, value);
  }
  return texture;
}

function makeLightTable(gl) {
  const texture = makeTexture(gl, gl.TEXTURE_2D, LIGHT);
  const table = new Int32Array([...lightOfCodes(), ...leastLightOfCodes()]);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32I, 256, 2, 0, gl.RED_INTEGER, gl.INT, table);
  return texture;
}

function flipRows(pixels, stride) {
  const flipped = new Uint8Array(pixels.length);
  for (let from = 0, to = pixels.length - stride; to >= 0; from += stride, to -= stride) {
    flipped.set(pixels.subarray(from, from + stride), to);
  }
  return flipped;
}
