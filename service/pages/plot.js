/** Small line plots as SVG: numbers of each frame. */

const SVG = "http://www.w3.org/2000/svg";
const [WIDTH, HEIGHT, LEFT, BOTTOM, TOP] = [360, 150, 44, 20, 8];

function shape(name, attributes, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

/** Return steps that people like: 1, 2 or 5 times a power of ten. */
function niceTop(value) {
  if (!(value > 0)) return 1;
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].find((step) => step * power >= value) * power;
}

/**
 * Return a figure of one or two curves over the frames.
 *
 * `curves`: `[{ label, values: [[frame, value], …] }, …]`
 */
export function plot(title, unit, curves) {
  const points = curves.flatMap(({ values }) => values).filter(([, y]) => Number.isFinite(y));
  const first = Math.min(...points.map(([x]) => x));
  const last = Math.max(...points.map(([x]) => x), first + 1);
  const top = niceTop(Math.max(...points.map(([, y]) => y)));
  const at = (x, y) => [
    LEFT + ((x - first) / (last - first)) * (WIDTH - LEFT - 8),
    HEIGHT - BOTTOM - (y / top) * (HEIGHT - BOTTOM - TOP),
  ];
  const said = curves.map(({ label, values }) => {
    const ys = values.map(([, y]) => y).filter(Number.isFinite);
    const mean = ys.reduce((a, b) => a + b, 0) / ys.length;
    return `${label}: mean ${mean.toPrecision(3)} ${unit}`;
  });
  const image = shape("svg", {
    viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "plot", role: "img",
    "aria-label": `${title} by frame. ${said.join("; ")}`,
  });
  for (const share of [0, 0.5, 1]) {
    const [x, y] = at(first, share * top);
    image.append(shape("line", { class: "axis", x1: x, x2: WIDTH - 8, y1: y, y2: y }));
    image.append(shape("text", { x: x - 5, y: y + 4, "text-anchor": "end" },
      Number((share * top).toPrecision(3))));
  }
  for (const [x, anchor] of [[first, "start"], [last, "end"]]) {
    image.append(shape("text", { x: at(x, 0)[0], y: HEIGHT - 5, "text-anchor": anchor }, x));
  }
  curves.forEach(({ values }, number) => {
    const line = values.filter(([, y]) => Number.isFinite(y)).map((point) => at(...point).join(","));
    image.append(shape("polyline", { class: `curve ${"ab"[number]}`, points: line.join(" ") }));
  });
  const caption = document.createElement("figcaption");
  caption.className = "small";
  caption.append(`${title}${unit ? ` (${unit})` : ""} `);
  if (curves.length > 1) {
    curves.forEach(({ label }, number) => {
      const key = document.createElement("span");
      key.className = `key ${"ab"[number]}`;
      key.textContent = label;
      caption.append(key, " ");
    });
  }
  const figure = document.createElement("figure");
  figure.style.margin = "0";
  figure.append(caption, image);
  return figure;
}
