/**
 * Draws every way of looking from one video of both eyes side by side (WebGL 2).
 *
 * What the result is compared with is the observed picture, enlarged bicubically here, with the
 * kernel of OpenCV, on the very grid of the result.
 */

const COVER = `#version 300 es
void main() {
  vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(corner, 0.0, 1.0);
}`;

const VIEW = `#version 300 es
precision highp float;
precision highp int;
uniform sampler2D result;
uniform sampler2D before;
uniform int mode;          // 0 side by side, 1 top and bottom, 2 anaglyph, 3 one eye, 4 compare
uniform bool stereo;       // false: there is one eye only
uniform bool swapped;
uniform int eye;           // of the modes that show one
uniform float wipe;        // share of the width that shows the bicubic picture
uniform float zoom;
uniform vec2 centre;       // of the zoomed part, share of the eye
uniform vec2 canvas;       // pixels
uniform vec2 eyeSize;      // of the result, pixels
uniform vec2 eyePitch;     // from one eye to the other in the video, pixels
uniform vec2 beforeSize;
uniform vec2 beforePitch;
uniform bool decimated;    // the observed pixel i sits on pixel K i of the grid
out vec4 colour;

int look(int wanted) { return stereo ? (swapped ? 1 - wanted : wanted) : 0; }

vec3 resultAt(int wanted, vec2 place) {  // place: share of the eye, y down
  vec2 size = vec2(textureSize(result, 0));
  vec2 p = clamp(place * eyeSize, vec2(0.5), eyeSize - 0.5) + eyePitch * float(look(wanted));
  return texture(result, p / size).rgb;
}

vec4 weights(float t) {    // Keys' cubic with a = -0.75 at 1+t, t, 1-t, 2-t
  const float a = -0.75;
  vec4 d = vec4(1.0 + t, t, 1.0 - t, 2.0 - t);
  vec4 far = a * (d * d * d - 5.0 * d * d + 8.0 * d - 4.0);
  vec4 near = (a + 2.0) * d * d * d - (a + 3.0) * d * d + 1.0;
  return vec4(far.x, near.y, near.z, far.w);
}

vec3 beforeAt(int wanted, vec2 place) {
  vec2 step = eyeSize / beforeSize;
  vec2 fine = place * eyeSize - 0.5;               // pixel of the grid
  vec2 p = decimated ? fine / step : (fine + 0.5) / step - 0.5;
  vec2 base = floor(p);
  vec4 wx = weights(p.x - base.x);
  vec4 wy = weights(p.y - base.y);
  ivec2 shift = ivec2(beforePitch) * look(wanted);
  vec3 sum = vec3(0.0);
  for (int y = 0; y < 4; y++) {
    for (int x = 0; x < 4; x++) {
      vec2 at = clamp(base + vec2(x - 1, y - 1), vec2(0.0), beforeSize - 1.0);
      sum += wx[x] * wy[y] * texelFetch(before, ivec2(at) + shift, 0).rgb;
    }
  }
  return clamp(sum, 0.0, 1.0);
}

vec3 linear(vec3 c) {
  return mix(pow((c + 0.055) / 1.055, vec3(2.4)), c / 12.92, lessThanEqual(c, vec3(0.04045)));
}

vec3 encoded(vec3 c) {
  return mix(1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, c * 12.92, lessThanEqual(c, vec3(0.0031308)));
}

// Dubois' least-squares matrices for red-cyan glasses; columns of GLSL are columns of the matrix.
const mat3 LEFT = mat3(0.437, -0.062, -0.048, 0.449, -0.062, -0.050, 0.164, -0.024, -0.017);
const mat3 RIGHT = mat3(-0.011, 0.377, -0.026, -0.032, 0.761, -0.093, -0.007, 0.009, 1.234);

void main() {
  vec2 place = vec2(gl_FragCoord.x, canvas.y - gl_FragCoord.y) / canvas;
  if (mode == 0) {
    int side = place.x < 0.5 ? 0 : 1;
    colour = vec4(resultAt(side, vec2(fract(place.x * 2.0), place.y)), 1.0);
  } else if (mode == 1) {
    int side = place.y < 0.5 ? 0 : 1;
    colour = vec4(resultAt(side, vec2(place.x, fract(place.y * 2.0))), 1.0);
  } else if (mode == 2) {
    vec3 left = clamp(LEFT * linear(resultAt(0, place)), 0.0, 1.0);
    vec3 right = clamp(RIGHT * linear(resultAt(1, place)), 0.0, 1.0);
    colour = vec4(encoded(clamp(left + right, 0.0, 1.0)), 1.0);
  } else {
    vec2 inner = centre + (place - 0.5) / zoom;
    bool old = mode == 4 && place.x < wipe;
    vec3 seen = old ? beforeAt(eye, inner) : resultAt(eye, inner);
    if (mode == 4 && abs(place.x - wipe) * canvas.x < 1.0) seen = vec3(1.0);
    colour = vec4(seen, 1.0);
  }
}`;

/** Pictures of each video that are kept: as far apart as two of one frame may come. */
const KEPT = 4;

const UNITS = ["result", "before"];

const MODES = { sbs: 0, tab: 1, anaglyph: 2, left: 3, right: 3, compare: 4 };

export class StereoView {
  constructor(canvas) {
    this.canvas = canvas;
    this.flat = document.createElement("canvas");
    this.options = { mode: "sbs", half: false, swap: false, wipe: 0.5, zoom: 1, eye: "left",
      centre: [0.5, 0.5] };
    this.tracks = null;
    this.hasBefore = false; // whether the last drawing had both, of one frame
    this.shownFrame = null;
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => this.#begin());
    this.#begin();
  }

  /** Whether this browser can draw at all. */
  get works() {
    return Boolean(this.gl);
  }

  #begin() {
    const gl = this.canvas.getContext("webgl2", { alpha: false, antialias: false,
      preserveDrawingBuffer: true });
    this.gl = gl;
    if (!gl) return;
    this.program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, COVER], [gl.FRAGMENT_SHADER, VIEW]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
    }
    gl.linkProgram(this.program);
    gl.useProgram(this.program);
    gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, false);
    this.kept = { result: [], before: [] };
    UNITS.forEach((name, unit) => {
      this.#bind(unit, this.#texture());
      gl.uniform1i(gl.getUniformLocation(this.program, name), unit);
    });
    this.places = new Proxy({}, { get: (_, name) => gl.getUniformLocation(this.program, name) });
  }

  #bind(unit, texture) {
    this.gl.activeTexture(this.gl.TEXTURE0 + unit);
    this.gl.bindTexture(this.gl.TEXTURE_2D, texture);
  }

  #texture() {
    const gl = this.gl;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const [key, value] of [[gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T,
      gl.CLAMP_TO_EDGE], [gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR]]) {
      gl.texParameteri(gl.TEXTURE_2D, key, value);
    }
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE,
      new Uint8Array([0, 0, 0, 255]));
    return texture;
  }

  /** Say what the videos hold: `{ result, before, sampling }` as the service describes them. */
  describe(tracks, sampling) {
    this.tracks = tracks;
    this.sampling = sampling;
  }

  /** Take a picture of a video (or image), of a frame by number, as the result or as `before`. */
  take(name, source, frame) {
    const gl = this.gl;
    const kept = this.kept[name];
    const same = kept.findIndex((picture) => picture.frame === frame);
    const most = this.options.mode === "compare" ? KEPT : 1;
    const [spare, ...rest] = same >= 0 ? kept.splice(same, 1) : kept.splice(most - 1);
    for (const { texture } of rest) gl.deleteTexture(texture);
    const texture = spare?.texture ?? this.#texture();
    this.#bind(UNITS.indexOf(name), texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, this.#pixelsOf(source));
    kept.unshift({ frame, texture });
  }

  /**
   * The pixels of a picture, as a canvas. Taken straight from a decoder that pads its planes, the
   * colour of the last row would be mixed with the padding, which is green.
   */
  #pixelsOf(source) {
    const { flat } = this;
    const width = source.displayWidth ?? source.videoWidth ?? source.naturalWidth;
    const height = source.displayHeight ?? source.videoHeight ?? source.naturalHeight;
    if (flat.width !== width || flat.height !== height) Object.assign(flat, { width, height });
    flat.getContext("2d", { alpha: false }).drawImage(source, 0, 0);
    return flat;
  }

  /** Let go of the pictures of a video. */
  forget(name) {
    for (const { texture } of this.kept?.[name].splice(0) ?? []) this.gl.deleteTexture(texture);
    if (name === "before") this.hasBefore = false;
    else this.shownFrame = null;
  }

  /** The newest result of whose frame `before` has come too; the newest of all where there is none. */
  #pair() {
    const { result, before } = this.kept;
    if (this.options.mode === "compare") {
      for (const one of result) {
        const other = before.find(({ frame }) => frame === one.frame);
        if (other) return [one, other];
      }
    }
    return [result[0], null];
  }

  draw() {
    const { gl, options, tracks } = this;
    const track = tracks?.result;
    if (!gl || !track) return;
    const [result, before] = this.#pair();
    if (!result) return;
    this.hasBefore = Boolean(before);
    this.shownFrame = result.frame;
    this.#bind(0, result.texture);
    if (before) this.#bind(1, before.texture);
    const stereo = track.layout === "sbs";
    let [width, height] = [track.eye_width, track.eye_height];
    if (options.mode === "sbs" && !options.half) width *= 2;
    if (options.mode === "tab" && !options.half) height *= 2;
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    gl.viewport(0, 0, width, height);
    const even = (size) => size + (size % 2);
    const observed = tracks.before ?? track;
    const at = this.places;
    gl.uniform1i(at.mode, options.mode === "compare" && !before ? 3 : MODES[options.mode]);
    gl.uniform1i(at.stereo, stereo);
    gl.uniform1i(at.swapped, options.swap);
    gl.uniform1i(at.eye, (options.mode === "compare" ? options.eye : options.mode) === "right" ? 1 : 0);
    gl.uniform1f(at.wipe, options.wipe);
    gl.uniform1f(at.zoom, options.mode === "compare" ? options.zoom : 1);
    gl.uniform2fv(at.centre, options.mode === "compare" ? options.centre : [0.5, 0.5]);
    gl.uniform2f(at.canvas, width, height);
    gl.uniform2f(at.eyeSize, track.eye_width, track.eye_height);
    gl.uniform2f(at.eyePitch, even(track.eye_width), 0);
    gl.uniform2f(at.beforeSize, observed.eye_width, observed.eye_height);
    gl.uniform2f(at.beforePitch, even(observed.eye_width), 0);
    gl.uniform1i(at.decimated, this.sampling === "decimation");
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
