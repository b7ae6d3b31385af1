// The selected tap drawn large: acceleration, what drives the device, error and temperature over one time axis, which
// can be zoomed and read.

import { CanvasPen, colours, lineOf, SvgPen } from "./curves.js";
import { largest } from "./words.js";

const G = 9.80665; // m/s^2
const FIRST_MS = 20; // time of a tap that is shown at first: what is felt of it
const ROOM = { left: 46, right: 10, top: 4, bottom: 36, between: 13 };
const NUMBER_PX = 13; // height of a number on a vertical axis
const TITLE_PX = 20; // height of a title with room around it
const DASHES = { clipped: [6, 4], start: [2, 3], warm: [9, 3], limit: [2, 3] };
const WIDTHS = { optimum: 2.2, warm: 1.8, recorded: 1, start: 1, clipped: 1, limit: 1 };

// Round numbers from `low` to `high`, rather some more of them than only zero.
function ticks(low, high, about) {
  const raw = (high - low) / about, power = 10 ** Math.floor(Math.log10(raw));
  const step = [10, 5, 2.5, 2, 1].map((m) => m * power).find((each) => each <= 1.26 * raw);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(Number((k * step).toPrecision(10)));
  return found;
}

// Straight lines, as corners with a gap behind them, in the middle of a pixel.
function upright(x, top, bottom) {
  return [Math.round(x) + 0.5, top, Math.round(x) + 0.5, bottom, NaN, NaN];
}

function level(left, right, y) {
  return [left, Math.round(y) + 0.5, right, Math.round(y) + 0.5, NaN, NaN];
}

export class Detail {
  // `read(words, now)`: what the curves are at the time that is pointed at, in words.
  constructor(element, read) {
    Object.assign(this, { element, read, canvas: element.querySelector("canvas"), hidden: new Set(), zoomed: () => undefined });
    element.addEventListener("keydown", (event) => this.key(event));
    element.addEventListener("pointermove", (event) => this.pointed(event));
    element.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      this.from = this.timeAt(event.offsetX);
      element.setPointerCapture(event.pointerId);
    });
    element.addEventListener("pointerup", (event) => {
      const ends = [this.from, this.timeAt(event.offsetX)].sort((a, b) => a - b);
      const far = this.from !== null && Math.abs(this.timeX(ends[1]) - this.timeX(ends[0])) > 8;
      this.from = null;
      if (far) this.zoom(...ends);
    });
    element.addEventListener("pointerleave", () => this.point(null));
    element.addEventListener("dblclick", () => this.first());
    this.from = this.cursor = null;
    new ResizeObserver(([{ contentRect: { width, height } }]) => {
      Object.assign(this, { width, height });
      this.draw();
    }).observe(element);
  }

  // Begins with a scene; its first milliseconds are shown once a tap is there.
  open(scene) {
    Object.assign(this, { scene, view: null, frame: null, cursor: null });
  }

  get whole() {
    return this.frame.whole;
  }

  first() {
    const [from, to] = this.whole;
    this.zoom(from, this.scene.between ? Math.min(to, FIRST_MS / 1e3) : to);
  }

  zoom(from, to) {
    const [least, most] = this.whole, dt = this.frame.times[1] - this.frame.times[0];
    const span = Math.min(Math.max(to - from, 8 * dt), most - least);
    const begin = Math.min(Math.max(from, least), most - span);
    this.view = [begin, begin + span];
    this.zoomed();
    this.draw();
  }

  // Wider (> 1) or nearer (< 1), around what is read or the middle.
  scale(factor) {
    const [from, to] = this.view, around = this.cursor ?? (from + to) / 2;
    this.zoom(around - factor * (around - from), around + factor * (to - around));
  }

  shift(share) {
    const [from, to] = this.view;
    this.zoom(from + share * (to - from), to + share * (to - from));
  }

  key(event) {
    const [from, to] = this.view ?? [0, 0], step = (to - from) / 40;
    const actions = {
      "+": () => this.scale(1 / 1.5), "=": () => this.scale(1 / 1.5), "-": () => this.scale(1.5), Home: () => this.first(),
      End: () => this.zoom(...this.whole), PageUp: () => this.shift(-0.5), PageDown: () => this.shift(0.5),
      ArrowLeft: () => this.point((this.cursor ?? from) - step), ArrowRight: () => this.point((this.cursor ?? from) + step),
      Escape: () => this.point(null),
    };
    if (!this.view || !actions[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    actions[event.key]();
  }

  pointed(event) {
    if (this.view && event.offsetX >= ROOM.left) this.point(this.timeAt(event.offsetX));
  }

  point(time) {
    this.cursor = time === null ? null : Math.min(Math.max(time, this.view[0]), this.view[1]);
    this.draw();
  }

  timeX(time) {
    const [from, to] = this.view;
    return ROOM.left + ((time - from) / (to - from)) * (this.width - ROOM.left - ROOM.right);
  }

  timeAt(x) {
    if (!this.view) return null;
    const [from, to] = this.view;
    return from + ((x - ROOM.left) / (this.width - ROOM.left - ROOM.right)) * (to - from);
  }

  // `kept`: the scales stay while a slider or the handle is dragged, as long as the curves are inside.
  show(frame, tap, start, kept) {
    Object.assign(this, { frame, tap, start });
    if (!this.view) this.first();
    else this.draw(kept);
  }

  curves() {
    const { tap, start } = this, { times } = this.frame;
    const inG = (values) => values?.map((a) => a / G);
    const recorded = inG(tap.recorded_m_s2);
    const error = (values) => (values?.length ? inG(values).map((a, j) => a - recorded[j]) : []);
    const limit = [tap.input_limit, -tap.input_limit].map((value) => ["limit", this.view, [value, value]]);
    const found = {
      acceleration: [["clipped", times, inG(tap.clipped_m_s2)], ["start", start?.times, inG(start?.optimum_m_s2)],
        ["recorded", times, recorded], ["optimum", times, inG(tap.optimum_m_s2)], ["warm", times, inG(tap.warm_m_s2)]],
      input: [["clipped", times, tap.clipped_input], ["start", start?.times, start?.input], ["optimum", times, tap.input],
        ["warm", times, tap.warm_input], ...limit],
      error: [["clipped", times, error(tap.clipped_m_s2)], ["optimum", times, error(tap.optimum_m_s2)],
        ["warm", times, error(tap.warm_m_s2)]],
    };
    if (tap.temperature_C.length) found.temperature = [["optimum", times, tap.temperature_C]];
    return found;
  }

  // Ends of a panel's axis, with room above what is shown.
  range(name, curves, kept) {
    const own = (names) => curves.filter(([curve]) => names.includes(curve) && !this.hidden.has(curve)).map(([, , values]) => largest(values ?? []));
    if (name === "temperature") {
      const values = curves[0][2];
      let low = Infinity, high = -Infinity;
      for (const value of values) {
        low = Math.min(low, value);
        high = Math.max(high, value);
      }
      const own = Number.isFinite(low) ? [low - 0.02 * (high - low) - 1e-3, high + 0.1 * (high - low) + 1e-3] : [0, 1];
      const before = kept && this.ranges?.temperature;
      return before ? [Math.min(own[0], before[0]), Math.max(own[1], before[1])] : own;
    }
    const decide = { acceleration: ["recorded", "optimum"], input: ["limit", "start"], error: ["optimum", "clipped"] }[name];
    const most = Math.max(...own(decide), 1e-6) * (name === "input" ? 1.32 : 1.12);
    const before = this.ranges?.[name]?.[1];
    const stays = kept && before && most <= 1.3 * before && (name !== "input" || this.tap.input_limit < 0.98 * before);
    const end = stays ? before : most;
    return [-end, end];
  }

  draw(kept = false) {
    if (!this.frame || !this.view || !this.width) return;
    this.drawn(new CanvasPen(this.canvas, this.width, this.height), this.height, kept);
    this.element.dataset.frame = this.frame.number;
    this.readOut();
  }

  // Draws axes, curves and titles with a pen, down to `height`.
  drawn(pen, height, kept, head = ROOM.top) {
    const colour = colours(), curves = this.curves(), names = Object.keys(curves);
    const heights = { acceleration: 3, input: 2.6, error: 1.5, temperature: 1.2 };
    const { name, unit } = this.scene.driven_by, C = this.tap.temperature_limit_C;
    const titles = { acceleration: "acceleration, g", input: `${name}, ${unit}`, error: "error, g",
      temperature: `winding, C${C ? `; limit ${Number(C.toPrecision(4))}` : ""}` };
    const free = height - head - ROOM.bottom - ROOM.between * (names.length - 1);
    const whole = names.reduce((sum, each) => sum + heights[each], 0);
    const [left, right] = [ROOM.left, this.width - ROOM.right];
    this.panels = {};
    this.ranges = Object.fromEntries(names.map((each) => [each, this.range(each, curves[each], kept)]));
    let top = head;
    const { window_end_s: ended } = this.scene, across = ticks(...this.view.map((t) => 1e3 * t), Math.max(Math.min(this.width / 90, 10), 4));
    for (const each of names) {
      const size = (heights[each] / whole) * free, bottom = top + size, [low, high] = this.ranges[each];
      const y = (value) => bottom - ((value - low) / (high - low)) * size;
      this.panels[each] = { top, bottom, low, high, y };
      let values = ticks(low, high, Math.max(size / 24, 3));
      if (values.length * NUMBER_PX > size) values = ticks(low, high, 2);
      pen.stroke([...across.flatMap((t) => upright(this.timeX(t / 1e3), top, bottom)), ...values.flatMap((value) => level(left, right, y(value)))],
        colour.grid);
      if (values.includes(0)) pen.stroke(level(left, right, y(0)), colour.line);
      for (const value of values) pen.write(String(Number(value.toPrecision(6))), left - 6, y(value) + 4, { anchor: "end", room: left - 8 });
      pen.within({ x: left, y: top, width: right - left, height: size }, () => {
        for (const [curve, times, values] of curves[each]) {
          if (!times || !values?.length || (curve !== "limit" && this.hidden.has(curve))) continue;
          const line = curve === "limit" ? level(left, right, y(values[0]))
            : lineOf(times, values, this.view, { left, pixels: right - left, zero: y(0), unit: y(0) - y(1) });
          pen.stroke(line, colour[curve], { width: WIDTHS[curve], dashes: DASHES[curve] });
        }
      });
      // The limit's handle lies at the upper right of the input, whose title is below both limits where there is room.
      const lowest = y(-this.tap.input_limit), under = bottom - lowest > TITLE_PX ? bottom - 5 : (y(0) + lowest) / 2 + 5;
      pen.write(titles[each], right - 4, each === "input" ? under : top + 13, { anchor: "end", bare: false });
      top = bottom + ROOM.between;
    }
    const bottom = top - ROOM.between;
    if (ended > this.view[0] && ended < this.view[1]) pen.stroke(upright(this.timeX(ended), head, bottom), colour.line, { dashes: [8, 3, 2, 3] });
    for (const t of across) pen.write(String(t), this.timeX(t / 1e3), bottom + 15, { anchor: "middle" });
    pen.write("time after contact, ms", (left + right) / 2, bottom + 31, { anchor: "middle" });
    if (this.cursor !== null) pen.stroke(upright(this.timeX(this.cursor), head, bottom), colour.ink);
  }

  // Reads out the curves at the cursor.
  readOut() {
    const { cursor, frame, tap } = this;
    if (cursor === null) return this.read("", null);
    const { times } = frame, at = Math.min(Math.max(Math.round((cursor - times[0]) / (times[1] - times[0])), 0), times.length - 1);
    const number = (values, unit) => `${Number(values[at].toPrecision(3))} ${unit}`;
    const inG = (values) => `${(values[at] / G).toFixed(2)} g`;
    const words = [`recorded ${inG(tap.recorded_m_s2)}`];
    if (tap.certified) words.push(`optimum ${inG(tap.optimum_m_s2)}`, `${this.scene.driven_by.name} ${number(tap.input, this.scene.driven_by.unit)}`);
    words.push(`clipped ${inG(tap.clipped_m_s2)}`);
    if (tap.certified && tap.temperature_C.length > at) words.push(`winding ${tap.temperature_C[at].toFixed(2)} C`);
    return this.read(`${(1e3 * times[at]).toFixed(1)} ms: ${words.join(", ")}`, 1e3 * times[at]);
  }

  // Where a value of the input lies in the element, and back.
  inputY(value) {
    return this.panels?.input.y(value);
  }

  inputAt(y) {
    const { top, bottom, low, high } = this.panels.input;
    return low + ((bottom - y) / (bottom - top)) * (high - low);
  }

  // A file of the picture, with its title.
  async file(kind, title) {
    const width = 1200, height = 800, head = 34, kept = [this.width, this.cursor], canvas = new OffscreenCanvas(1, 1);
    const pen = kind === "svg" ? new SvgPen(width, height) : new CanvasPen(canvas, width, height, { ratio: 2, font: "13px sans-serif" });
    [this.width, this.cursor] = [width, null];
    pen.write(title, ROOM.left, 22);
    this.drawn(pen, height, true, head + ROOM.top);
    [this.width, this.cursor] = kept;
    this.draw(true);
    return kind === "svg" ? new Blob([pen.text], { type: "image/svg+xml" }) : canvas.convertToBlob({ type: "image/png" });
  }
}
