// Lines of many samples, as pixels show them; colours as the page has them.

const NAMES = ["ground", "ink", "quiet", "grid", "recorded", "optimum", "clipped", "start", "warm", "limit", "line"];
const SMALL_PX = 62;

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

// One tap on a canvas of some width on the page: accelerations above, what drives the device below, between its limits.
// `scale`: the largest acceleration and input that are shown, and the time [from, to], of all such canvases alike.
export function drawSmall(canvas, width, times, tap, scale, hidden = new Set(), start = null) {
  const ratio = window.devicePixelRatio || 1, colour = colours(), [from, to] = scale.view;
  if (canvas.width !== Math.round(width * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(SMALL_PX * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, SMALL_PX);
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
  line("recorded", times, tap.recorded_m_s2, above, high, 1.2, []);
  line("optimum", times, tap.optimum_m_s2, above, high, 1.6, []);
  line("warm", times, tap.warm_m_s2, above, high, 1.2, [6, 2]);
  for (const side of [-1, 1]) line("limit", [from, to], [side * tap.input_limit, side * tap.input_limit], below, low, 1, [2, 3]);
  line("clipped", times, tap.clipped_input, below, low, 1, [4, 3]);
  line("optimum", times, tap.input, below, low, 1.4, []);
  line("warm", times, tap.warm_input, below, low, 1.2, [6, 2]);
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
