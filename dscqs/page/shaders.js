/** The shaders: from one stereo source to the pixels of a display, in whole numbers. */

import { WHITE } from "./anaglyph.js";

/** One triangle that covers everything. */
export const COVER = `#version 300 es
void main() {
  vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(corner, 0.0, 1.0);
}`;

/** Fetches pixels of an eye: shared by the shader of displays and that of headsets. */
export const FETCH = `
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler2DArray;
uniform sampler2D picture;      // RGBA, both eyes side by side
uniform sampler2DArray planes;  // G, B, R as lossless RGB video holds them
uniform bool planar;
uniform bool stereo;            // false: both eyes get the same picture
uniform bool swapped;
uniform bool filled;            // true: nothing but the surround
uniform ivec2 eyeSize;
uniform ivec2 origin;           // of the eye's picture on its screen
uniform ivec3 surround;

// The pixel (8 bits) that an eye (0: left, 1: right) sees at a place of its screen.
ivec3 look(int eye, ivec2 place) {
  ivec2 p = place - origin;
  if (filled || p.x < 0 || p.y < 0 || p.x >= eyeSize.x || p.y >= eyeSize.y) return surround;
  if (stereo && (eye == 1) != swapped) p.x += eyeSize.x;
  vec3 found = planar
    ? vec3(
        texelFetch(planes, ivec3(p, 2), 0).r,
        texelFetch(planes, ivec3(p, 0), 0).r,
        texelFetch(planes, ivec3(p, 1), 0).r)
    : texelFetch(picture, p, 0).rgb;
  return ivec3(found * 255.0 + 0.5);
}
`;

/** Where the pixel p of the signal comes from, for the codes of the modes in layout.js. */
const PIXELS = Object.freeze([
  "return look(0, p);",
  "return look(1, p);",
  `int eye = p.x < signal.x / 2 ? 0 : 1;
  return look(eye, ivec2(p.x - eye * (signal.x / 2), p.y));`,
  `int eye = p.x < signal.x / 2 ? 0 : 1;
  p.x = 2 * (p.x - eye * (signal.x / 2));
  return (look(eye, p) + look(eye, p + ivec2(1, 0)) + 1) / 2;`,
  `int eye = p.y < signal.y / 2 ? 0 : 1;
  return look(eye, ivec2(p.x, p.y - eye * (signal.y / 2)));`,
  `int eye = p.y < signal.y / 2 ? 0 : 1;
  p.y = 2 * (p.y - eye * (signal.y / 2));
  return (look(eye, p) + look(eye, p + ivec2(0, 1)) + 1) / 2;`,
  "return look((p.y + phase) & 1, p);",
  "return look((p.x + phase) & 1, p);",
  "return look((p.x + p.y + phase) & 1, p);",
  "return anaglyph(p);",
  `// A blue line in the last row tells the glasses: a quarter long, left; three quarters, right.
  int blue = p.x < (turn == 0 ? signal.x / 4 : 3 * signal.x / 4) ? 255 : 0;
  return blueLine && p.y == signal.y - 1 ? ivec3(0, 0, blue) : look(turn, p);`,
]);

const ANAGLYPH = 9;

const ANAGLYPH_ARITHMETIC = `
precision highp isampler2D;
uniform isampler2D light;       // row 0: linear light of a code; row 1: least light of a code
uniform ivec3 duboisLeft[3];
uniform ivec3 duboisRight[3];
const int WHITE = ${WHITE};

ivec3 lightOf(ivec3 code) {
  return ivec3(
    texelFetch(light, ivec2(code.r, 0), 0).r,
    texelFetch(light, ivec2(code.g, 0), 0).r,
    texelFetch(light, ivec2(code.b, 0), 0).r);
}

int codeOf(int value) {
  int code = 0;
  for (int step = 128; step > 0; step >>= 1) {
    if (value >= texelFetch(light, ivec2(code + step, 1), 0).r) code += step;
  }
  return code;
}

// One eye's part of one colour, thousandths of light, within what a screen can give.
int share(ivec3 weights, ivec3 eye) {
  int sum = weights.x * eye.x + weights.y * eye.y + weights.z * eye.z;
  return clamp(sum, 0, 1000 * WHITE);
}

ivec3 anaglyph(ivec2 p) {
  ivec3 left = lightOf(look(0, p));
  ivec3 right = lightOf(look(1, p));
  ivec3 made;
  for (int i = 0; i < 3; i++) {
    int sum = share(duboisLeft[i], left) + share(duboisRight[i], right);
    made[i] = codeOf(min(sum / 1000, WHITE));
  }
  return made;
}
`;

/** Return the shader of a display that takes one flat signal, by the code of its mode. */
export function displayShader(code) {
  return `#version 300 es
${FETCH}
uniform ivec2 signal;
uniform int phase;
uniform int turn;               // whose frame it is, in turns
uniform bool blueLine;
out vec4 colour;
${code === ANAGLYPH ? ANAGLYPH_ARITHMETIC : ""}
ivec3 pixel(ivec2 p) {
  ${PIXELS[code]}
}

void main() {
  ivec2 p = ivec2(gl_FragCoord.xy);
  colour = vec4(vec3(pixel(ivec2(p.x, signal.y - 1 - p.y))) / 255.0, 1.0);
}`;
}

/** A headset: a flat screen in front of the eyes, unlit, nearest pixel. */
export const SCREEN_IN_SPACE = `#version 300 es
uniform mat4 view;
uniform mat4 projection;
uniform vec3 place;   // middle of the screen, metres
uniform vec2 extent;  // half its width and height, metres
out vec2 where;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  where = vec2(corner.x, 1.0 - corner.y);
  vec3 at = place + vec3((corner * 2.0 - 1.0) * extent, 0.0);
  gl_Position = projection * view * vec4(at, 1.0);
}`;

export const HEADSET = `#version 300 es
${FETCH}
uniform int eye;
uniform ivec2 screenSize;
in vec2 where;
out vec4 colour;
void main() {
  ivec2 p = min(ivec2(where * vec2(screenSize)), screenSize - 1);
  colour = vec4(vec3(look(eye, p)) / 255.0, 1.0);
}`;
