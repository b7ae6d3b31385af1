// All taps small, speed by grip, on one scale: curves, tap error in words, and as a bar with the floor marked.

import { drawSmall, penOf } from "./curves.js";
import { differs, label, made, write } from "./words.js";

const LIMITED = 1.05; // times the floor: above, a limit holds the tap back

export function came(tap, limited = " *") {
  if (!tap.certified) return "refused";
  return `${tap.cells.tap} %${isLimited(tap) ? limited : ""}`;
}

export function isLimited(tap) {
  return Boolean(tap.figures) && tap.figures.tap_error > LIMITED * tap.floor;
}

export class Matrix {
  constructor(element, selects) {
    Object.assign(this, { element, selects, cells: [], full: 0, boxes: null, drawn: null });
    this.canvas = made("canvas", { attributes: { "aria-hidden": "true" } }); // one for all: each would be painted apart
    new ResizeObserver(() => {
      this.boxes = null;
      if (this.drawn) this.show(...this.drawn);
    }).observe(element);
    element.addEventListener("keydown", (event) => this.key(event));
  }

  open(places) {
    this.places = places;
    Object.assign(this, { full: 0, boxes: null, drawn: null });
    const nodes = places.filter((place) => !place.between);
    this.grips = nodes.length && !nodes[0].target ? [...new Set(nodes.map((place) => place.grip_N))] : [];
    const speeds = [...new Set(nodes.map((place) => place.speed_m_s))];
    const head = (text, row, column) => {
      const cell = made("span", { className: "head", textContent: text, attributes: { "aria-hidden": "true" } });
      Object.assign(cell.style, { gridRow: row, gridColumn: column });
      return cell;
    };
    this.cells = places.map((place, index) => this.cell(place, index));
    this.element.replaceChildren();
    this.element.classList.toggle("named", !this.grips.length);
    if (this.grips.length) {
      this.element.style.gridTemplateColumns = `max-content repeat(${speeds.length}, minmax(5.2rem, 18rem))`;
      speeds.forEach((speed, j) => this.element.append(head(`${Number(speed.toPrecision(4))} m/s`, 1, j + 2)));
      this.grips.forEach((grip, k) => this.element.append(head(`${Number(grip.toPrecision(4))} N`, k + 2, 1)));
      places.forEach((place, index) => {
        const j = place.between ? 0 : speeds.indexOf(place.speed_m_s), k = place.between ? this.grips.length : this.grips.indexOf(place.grip_N);
        if (place.between) this.element.append(head("between", k + 2, 1));
        Object.assign(this.cells[index].style, { gridRow: k + 2, gridColumn: place.between ? "2 / 4" : j + 2 });
      });
    } else {
      this.element.style.gridTemplateColumns = "";
    }
    this.element.append(...this.cells, this.canvas);
  }

  cell(place, index) {
    const named = place.target || place.between;
    const cell = made("button", { type: "button", className: "cell", attributes: { role: "option" } },
      ...(named ? [made("span", { className: "place", textContent: place.title })] : []), made("span", { className: "curves" }),
      made("span", { className: "came", textContent: "..." }), made("span", { className: "bar" }, made("i"), made("b")));
    label(cell, place.title);
    cell.onclick = () => this.selects(index);
    return cell;
  }

  select(index) {
    this.cells.forEach((cell, j) => {
      cell.setAttribute("aria-selected", String(j === index));
      cell.tabIndex = j === index ? 0 : -1;
    });
    const { element } = this, cell = this.cells[index];
    if (!cell) return;
    // The selected cell comes into sight where not all have room; the page itself does not move.
    for (const [scroll, offset, size, room] of [["scrollTop", "offsetTop", "offsetHeight", "clientHeight"],
      ["scrollLeft", "offsetLeft", "offsetWidth", "clientWidth"]]) {
      element[scroll] = Math.min(Math.max(element[scroll], cell[offset] + cell[size] - element[room]), cell[offset]);
    }
  }

  // Where the small plots lie. It is read once, since reading after a change costs another layout.
  measure() {
    this.boxes = this.cells.map((cell) => cell.querySelector(".curves")).map((plot) => (
      { x: plot.offsetLeft, y: plot.offsetTop, width: plot.clientWidth, height: plot.clientHeight }));
    this.size = [["x", "width"], ["y", "height"]].map(([from, size]) => Math.max(1, ...this.boxes.map((box) => box[from] + box[size])));
    [this.canvas.style.width, this.canvas.style.height] = this.size.map((pixels) => `${pixels}px`);
  }

  // Everything of one answer, at one scale.
  show(frame, view, hidden, start) {
    this.drawn = [frame, view, hidden, start];
    if (!this.boxes) this.measure();
    const taps = frame.taps.filter((tap) => tap && this.cells[tap.index]);
    const scale = { view, acceleration: Math.max(...taps.map((tap) => tap.recorded_peak_m_s2), 1e-9),
      input: Math.max(...taps.map((tap) => tap.input_limit)) };
    const most = Math.max(...taps.flatMap((tap) => [tap.figures?.tap_error ?? 0, tap.floor]));
    if (most > this.full || most < 0.5 * this.full) this.full = Math.ceil(12 * most) / 10; // a round one, with room for more
    const pen = penOf(this.canvas, ...this.size);
    for (const tap of taps) {
      drawSmall(pen, this.boxes[tap.index], frame.times, tap, scale, hidden, start?.taps[tap.index] && { ...start.taps[tap.index], times: start.times });
      this.caption(tap, frame.number);
    }
  }

  caption(tap, number) {
    const cell = this.cells[tap.index];
    if (!cell) return;
    cell.classList.toggle("refused", !tap.certified);
    cell.classList.toggle("limited", isLimited(tap));
    write(cell.querySelector(".came"), came(tap));
    label(cell, `${this.places[tap.index].title}: ${came(tap, ", held back by a limit")}`);
    const percent = (share) => `${Math.min(100 * share / this.full, 100).toFixed(1)}%`;
    const place = (bar, side, share) => { if (differs(bar, side, share)) bar.style[side] = share; };
    place(cell.querySelector("i"), "width", percent(tap.figures?.tap_error ?? 0));
    place(cell.querySelector("b"), "left", percent(tap.floor));
    cell.dataset.frame = number;
  }

  key(event) {
    const rows = this.grips.length || 1;
    const steps = { ArrowRight: rows, ArrowLeft: -rows, ArrowDown: 1, ArrowUp: -1 };
    const last = this.cells.length - 1, now = this.cells.findIndex((cell) => cell.tabIndex === 0);
    const index = event.key === "Home" ? 0 : event.key === "End" ? last : now + (steps[event.key] ?? NaN);
    if (Number.isNaN(index)) return;
    event.preventDefault();
    const next = Math.min(Math.max(index, 0), last);
    this.selects(next);
    this.cells[next].focus();
  }
}
