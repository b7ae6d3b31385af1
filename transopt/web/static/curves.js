// Lines of many samples, as pixels show them; colours as the page has them.

const NAMES = ["ground", "ink", "quiet", "grid", "recorded", "optimum", "clipped", "start", "warm", "limit", "line"];
const SMALL_PX = 62;
const FONT = "12px system-ui, sans-serif";

let kept = null;
export function colours() {
  const style = getComputedStyle(document.documentElement);
  kept ??= Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  return kept;
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { kept = null; });

// Samples within [from, to], at most two for a pixel, the least and the greatest, which is all that a line of so many
// pixels can show. Calls `point(time, value, begins)`; a gap in the values is one in the line.
export function within(times, values, from, to, pixels, point) {
  const dt = times.length > 1 ? times[1] - times[0] : 1;
  const first = Math.max(Math.floor((from - times[0]) / dt) - 1, 0);
  const after = Math.min(Math.ceil((to - times[0]) / dt) + 2, values.length);
  const some = Math.max(Math.floor((after - first) / (2 * pixels)), 1);
  let begins = true;
  for (let at = first; at < after; at += some) {
    let low = at, high = at;
    for (let j = at; j < Math.min(at + some, after); j++) {
      if (values[j] < values[low]) low = j;
      if (values[j] > values[high]) high = j;
    }
    for (const j of low === high ? [low] : [Math.min(low, high), Math.max(low, high)]) {
      if (Number.isNaN(values[j])) {
        begins = true;
      } else {
        point(times[j], values[j], begins);
        begins = false;
      }
    }
  }
}

// The pen of an empty canvas, which draws in pixels of the page.
function penOf(canvas, width, height) {
  const ratio = window.devicePixelRatio || 1, size = [width, height].map((pixels) => Math.round(pixels * ratio));
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  return pen;
}

// One tap on a canvas of some width on the page: accelerations above, what drives the device below, between its limits.
// `scale`: the largest acceleration and input that are shown, and the time [from, to], of all such canvases alike.
export function drawSmall(canvas, width, times, tap, scale, hidden = new Set(), start = null) {
  const pen = penOf(canvas, width, SMALL_PX), colour = colours(), [from, to] = scale.view;
  const at = (t) => ((t - from) / (to - from)) * width;
  const line = (name, of, values, middle, size, thickness, dashes) => {
    if (hidden.has(name) || !values?.length) return;
    pen.beginPath();
    pen.strokeStyle = colour[name];
    pen.lineWidth = thickness;
    pen.setLineDash(dashes);
    within(of, values, from, to, width, (t, value, begins) => {
      if (begins) pen.moveTo(at(t), middle - value * size);
      else pen.lineTo(at(t), middle - value * size);
    });
    pen.stroke();
  };
  const high = 22 / scale.acceleration, low = 13 / scale.input, above = 25, below = 48;
  pen.fillStyle = colour.grid;
  pen.fillRect(0, below, width, 1);
  if (start) {
    line("start", start.times, start.optimum_m_s2, above, high, 1, [2, 2]);
    line("start", start.times, start.input, below, low, 1, [2, 2]);
  }
  line("clipped", times, tap.clipped_m_s2, above, high, 1, [4, 3]);
  line("recorded", times, tap.recorded_m_s2, above, high, 1, []);
  line("optimum", times, tap.optimum_m_s2, above, high, 1.6, []);
  line("warm", times, tap.warm_m_s2, above, high, 1, [6, 2]);
  for (const side of [-1, 1]) line("limit", [from, to], [side * tap.input_limit, side * tap.input_limit], below, low, 1, [2, 3]);
  line("clipped", times, tap.clipped_input, below, low, 1, [4, 3]);
  line("optimum", times, tap.input, below, low, 1.4, []);
  line("warm", times, tap.warm_input, below, low, 1, [6, 2]);
}

const SVG = "http://www.w3.org/2000/svg";

// The elements of a drawing as `parts` state them, [kind, attributes, text or parts]: what stays is not touched.
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
    for (const name of Object.keys(before)) if (!(name in attributes)) element.removeAttribute(name);
    for (const [name, value] of Object.entries(attributes)) if (before[name] !== value) element.setAttribute(name, value);
    element.stated = attributes;
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
      const area = clips.get(attributes["clip-path"]), inside = new Path2D();
      inside.rect(area.x, area.y, area.width, area.height);
      pen.save();
      pen.clip(inside);
      inner.forEach(one);
      pen.restore();
    } else if (kind === "path") {
      pen.stroke(new Path2D(attributes.d));
    } else if (kind === "line") {
      pen.stroke(new Path2D(`M${attributes.x1} ${attributes.y1}L${attributes.x2} ${attributes.y2}`));
    } else {
      pen.textAlign = attributes["text-anchor"];
      pen.lineJoin = attributes["stroke-linejoin"];
      pen.strokeText(inner, attributes.x, attributes.y);
      pen.fillText(inner, attributes.x, attributes.y);
    }
  };
  parts.forEach(one);
}
