// Lines of many samples, as pixels show them; colours as the page has them.

const NAMES = ["ground", "ink", "quiet", "grid", "recorded", "optimum", "clipped", "start", "warm", "limit", "line"];
export const SMALL_PX = 62; // height of a small plot, as page.css has it
const FONT = "12px system-ui, sans-serif";

let kept = null;
export function colours() {
  const style = getComputedStyle(document.documentElement);
  kept ??= Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  return kept;
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { kept = null; });

const DETAIL_PX = 0.2; // vertical distance of a curve from its line that is not seen

// A curve within the time `view` as the corners of a line, x and y in turn, as few as pass its samples within `DETAIL_PX`:
// each costs the browser. A gap in the values is NaN in the line. `place`: x of the begin of `view`, pixels, y of zero, and
// pixels of one unit of the values.
export function lineOf(times, values, view, { left, pixels, zero, unit }) {
  const dt = times.length > 1 ? times[1] - times[0] : 1, line = [], [from, to] = view, second = pixels / (to - from);
  const first = Math.max(Math.floor((from - times[0]) / dt) - 1, 0);
  const after = Math.min(Math.ceil((to - times[0]) / dt) + 2, values.length);
  // The last corner, the sample before the present one, and the slopes from the corner that pass all samples since.
  let x0 = NaN, y0 = NaN, x1 = NaN, y1 = NaN, least = NaN, most = NaN;
  for (let at = first; at < after; at++) {
    const x = left + (times[at] - from) * second, y = zero - values[at] * unit, slope = (y - y0) / (x - x0);
    if (!(slope >= least && slope <= most)) {
      if (at > first) line.push(x1, y1);
      [x0, y0, least, most] = [x1, y1, -Infinity, Infinity];
    }
    least = Math.max(least, (y - DETAIL_PX - y0) / (x - x0));
    most = Math.min(most, (y + DETAIL_PX - y0) / (x - x0));
    [x1, y1] = [x, y];
  }
  if (after > first) line.push(x1, y1);
  return line;
}

function strokeLine(pen, line) {
  let begins = true;
  pen.beginPath();
  for (let at = 0; at < line.length; at += 2) {
    const x = line[at], y = line[at + 1], gap = Number.isNaN(y);
    if (begins && !gap) pen.moveTo(x, y);
    else if (!gap) pen.lineTo(x, y);
    begins = gap;
  }
  pen.stroke();
}

// The pen of an empty canvas, which draws in pixels of the page.
export function penOf(canvas, width, height) {
  const ratio = window.devicePixelRatio || 1, size = [width, height].map((pixels) => Math.round(pixels * ratio));
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  return pen;
}

// One tap in a box of a canvas, its place and its width: accelerations above, what drives the device below, between its
// limits. `scale`: the largest acceleration and input that are shown, and the time `view`, of all such boxes alike. One
// that is not certified is faint and grey.
export function drawSmall(pen, box, times, tap, scale, hidden = new Set(), start = null) {
  const colour = colours(), { x: left, y: top, width: pixels } = box;
  const line = (name, of, values, middle, size, thickness, dashes) => {
    if (hidden.has(name) || !values?.length) return;
    pen.strokeStyle = tap.certified ? colour[name] : colour.quiet;
    pen.lineWidth = thickness;
    pen.setLineDash(dashes);
    strokeLine(pen, lineOf(of, values, scale.view, { left, pixels, zero: top + middle, unit: size }));
  };
  const high = 22 / scale.acceleration, low = 13 / scale.input, above = 25, below = 48;
  pen.save();
  pen.beginPath();
  pen.rect(left, top, pixels, SMALL_PX);
  pen.clip();
  pen.globalAlpha = tap.certified ? 1 : 0.35;
  pen.fillStyle = colour.grid;
  pen.fillRect(left, top + below, pixels, 1);
  if (start) {
    line("start", start.times, start.optimum_m_s2, above, high, 1, [2, 2]);
    line("start", start.times, start.input, below, low, 1, [2, 2]);
  }
  line("clipped", times, tap.clipped_m_s2, above, high, 1, [4, 3]);
  line("recorded", times, tap.recorded_m_s2, above, high, 1, []);
  line("optimum", times, tap.optimum_m_s2, above, high, 1.6, []);
  line("warm", times, tap.warm_m_s2, above, high, 1, [6, 2]);
  for (const side of [-1, 1]) line("limit", scale.view, [side * tap.input_limit, side * tap.input_limit], below, low, 1, [2, 3]);
  line("clipped", times, tap.clipped_input, below, low, 1, [4, 3]);
  line("optimum", times, tap.input, below, low, 1, []);
  line("warm", times, tap.warm_input, below, low, 1, [6, 2]);
  pen.restore();
}

const SVG = "http://www.w3.org/2000/svg";

function pathOf(line) {
  let d = "", begins = true;
  for (let at = 0; at < line.length; at += 2) {
    const [x, y] = [line[at], line[at + 1]].map((place) => Math.round(10 * place) / 10), gap = Number.isNaN(y);
    if (!gap) d += `${begins ? "M" : "L"}${x} ${y}`;
    begins = gap;
  }
  return d;
}

// The elements of a drawing as `parts` state them, [kind, attributes, text or parts], a path by its
// `line`: what stays is not touched.
export function sketch(drawing, parts) {
  parts.forEach(([kind, attributes, inner = ""], j) => {
    let element = drawing.children[j];
    if (element?.tagName !== kind) {
      const fresh = document.createElementNS(SVG, kind);
      if (element) element.replaceWith(fresh);
      else drawing.append(fresh);
      element = fresh;
    }
    const before = element.stated ?? {};
    const { line, ...stated } = attributes;
    if (line) stated.d = pathOf(line);
    for (const name of Object.keys(before)) if (!(name in stated)) element.removeAttribute(name);
    for (const [name, value] of Object.entries(stated)) if (before[name] !== value) element.setAttribute(name, value);
    element.stated = stated;
    if (typeof inner !== "string") sketch(element, inner);
    else if (element.textContent !== inner) element.textContent = inner;
  });
  while (drawing.children.length > parts.length) drawing.lastElementChild.remove();
}

// Paints parts on a canvas as `sketch` draws them: what changes with every answer is painted, since the elements of a
// drawing cost a browser several times as much. Of texts it knows the anchor and a halo, of groups a clipping rectangle.
export function paint(canvas, width, height, parts) {
  const pen = penOf(canvas, width, height), clips = new Map();
  pen.font = FONT;
  const one = ([kind, attributes, inner = ""]) => {
    const { stroke, fill } = attributes;
    pen.strokeStyle = stroke;
    pen.fillStyle = fill;
    pen.lineWidth = attributes["stroke-width"] ?? 1;
    pen.setLineDash(attributes["stroke-dasharray"]?.split(" ").map(Number) ?? []);
    if (kind === "clipPath") {
      clips.set(`url(#${attributes.id})`, inner[0][1]);
    } else if (kind === "g") {
      const area = clips.get(attributes["clip-path"]);
      pen.save();
      pen.beginPath();
      pen.rect(area.x, area.y, area.width, area.height);
      pen.clip();
      inner.forEach(one);
      pen.restore();
    } else if (kind === "path") {
      strokeLine(pen, attributes.line);
    } else if (kind === "line") {
      strokeLine(pen, [attributes.x1, attributes.y1, attributes.x2, attributes.y2]);
    } else {
      pen.textAlign = attributes["text-anchor"];
      pen.lineJoin = attributes["stroke-linejoin"];
      pen.strokeText(inner, attributes.x, attributes.y);
      pen.fillText(inner, attributes.x, attributes.y);
    }
  };
  parts.forEach(one);
}
