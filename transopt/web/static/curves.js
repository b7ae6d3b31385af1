// Lines of many samples, as pixels show them; colours as the page has them; what draws them on a canvas or in a file.

const NAMES = ["ground", "ink", "quiet", "grid", "recorded", "optimum", "clipped", "start", "warm", "limit", "line"];
export const SMALL_PX = 62; // height of a small plot, as page.css has it
const FULL_WIDTH = 5; // characters of a number on a vertical axis for which its room suffices in any font

let kept = null;
export function colours() {
  return kept ??= Object.fromEntries(NAMES.map((name) => [name, getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim()]));
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

function trace(pen, line) {
  let begins = true;
  for (let at = 0; at < line.length; at += 2) {
    const x = line[at], y = line[at + 1], gap = Number.isNaN(y);
    if (begins && !gap) pen.moveTo(x, y);
    else if (!gap) pen.lineTo(x, y);
    begins = gap;
  }
}

function strokeLine(pen, line) {
  pen.beginPath();
  trace(pen, line);
  pen.stroke();
}

// The context of an empty canvas, which draws in pixels of the page; `ground`: its colour, for one that is not transparent.
export function penOf(canvas, width, height, { ratio = devicePixelRatio || 1, ground = null } = {}) {
  const size = [width, height].map((pixels) => Math.round(pixels * ratio));
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  const pen = canvas.getContext("2d", { alpha: ground === null });
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.fillStyle = ground;
  if (ground === null) pen.clearRect(0, 0, width, height);
  else pen.fillRect(0, 0, width, height);
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

// What draws lines and words on an opaque canvas.
export class CanvasPen {
  constructor(canvas, width, height, { ratio, font = "12px system-ui, sans-serif" } = {}) {
    this.pen = penOf(canvas, width, height, { ratio, ground: colours().ground });
    this.pen.font = font;
  }

  // `line`: corners as of `lineOf`.
  stroke(line, colour, { width = 1, dashes = [] } = {}) {
    this.pen.strokeStyle = colour;
    this.pen.lineWidth = width;
    this.pen.setLineDash(dashes);
    strokeLine(this.pen, line);
  }

  // `anchor`: start, middle or end of the words is at x. `room`: pixels into which a long number is condensed. `bare`: the
  // ground shows through between the words; otherwise nothing drawn before does.
  write(words, x, y, { anchor = "start", room, bare = true } = {}) {
    const { pen } = this, { ground, ink } = colours();
    pen.textAlign = anchor === "middle" ? "center" : anchor;
    if (!bare) {
      const { actualBoundingBoxLeft: left, actualBoundingBoxRight: right } = pen.measureText(words);
      pen.fillStyle = ground;
      pen.fillRect(x - left - 2, y - 11, left + right + 4, 14);
    }
    pen.fillStyle = ink;
    pen.fillText(words, x, y, room);
  }

  // What `draws` draws, within a box.
  within({ x, y, width, height }, draws) {
    this.pen.save();
    this.pen.beginPath();
    this.pen.rect(x, y, width, height);
    this.pen.clip();
    draws();
    this.pen.restore();
  }
}

// The same as the text of an SVG.
export class SvgPen {
  constructor(width, height) {
    this.parts = [`<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}" `
      + `font-family="sans-serif" font-size="13"><rect width="100%" height="100%" fill="${colours().ground}"/>`];
    this.boxes = 0;
  }

  stroke(line, colour, { width = 1, dashes = [] } = {}) {
    let d = "";
    const step = (letter) => (...corner) => { d += letter + corner.map((place) => Math.round(10 * place) / 10).join(" "); };
    trace({ moveTo: step("M"), lineTo: step("L") }, line);
    const dashed = dashes.length ? ` stroke-dasharray="${dashes.join(" ")}"` : "";
    this.parts.push(`<path d="${d}" fill="none" stroke="${colour}" stroke-width="${width}"${dashed}/>`);
  }

  write(words, x, y, { anchor = "start", room, bare = true } = {}) {
    const { ground, ink } = colours(), written = words.replace(/[&<>]/g, (sign) => `&#${sign.charCodeAt(0)};`);
    const condensed = words.length > FULL_WIDTH && room ? ` textLength="${room}" lengthAdjust="spacingAndGlyphs"` : "";
    const halo = bare ? "" : ` paint-order="stroke" stroke="${ground}" stroke-width="4" stroke-linejoin="round"`;
    this.parts.push(`<text x="${x}" y="${y}" text-anchor="${anchor}" fill="${ink}"${condensed}${halo}>${written}</text>`);
  }

  within({ x, y, width, height }, draws) {
    const name = `box-${this.boxes += 1}`;
    this.parts.push(`<clipPath id="${name}"><rect x="${x}" y="${y}" width="${width}" height="${height}"/></clipPath><g clip-path="url(#${name})">`);
    draws();
    this.parts.push("</g>");
  }

  get text() {
    return `${this.parts.join("")}</svg>`;
  }
}
