// One number: a slider, the number typed, and back to where it was.

import { explain, label, made, quantity, shareOf, valueAt } from "./words.js";

const STEPS = 400;

export class Field {
  // `spec`: id, label, unit, tip, low, high, and log, integer, optional, or `at` and `share` of a scale of its own;
  // `opened`, where it goes back to; undefined for no way back.
  // `moved(value, how)`: how = { resting, step } with step "typed", "dragged" or "key" when it may be undone.
  constructor(spec, moved) {
    Object.assign(this, { spec, moved });
    const { id, label: name, unit } = spec;
    this.name = made("label", { htmlFor: id, textContent: name });
    this.number = made("input", {
      type: "text", id: `${id}-number`, inputMode: "decimal", autocomplete: "off", className: "number",
      attributes: { "aria-label": unit ? `${name}, ${unit}` : name },
    });
    this.range = made("input", { type: "range", id, min: 0, max: STEPS, step: 1 });
    this.back = made("button", { type: "button", className: "back", textContent: "\u21ba" });
    this.element = made("div", { className: "control", dataset: { tip: spec.tip ?? "" } }, this.name,
      made("span", { className: "value" }, this.number, made("span", { className: "unit", textContent: unit }), this.back),
      this.range);
    if (spec.optional) {
      this.stated = made("input", { type: "checkbox", attributes: { "aria-label": `state ${name}` } });
      this.stated.onchange = () => this.move(this.stated.checked ? this.sliderValue : null, { resting: true, step: "typed" });
      this.name.before(this.stated);
      this.element.classList.add("optional");
    }
    this.range.onpointerdown = () => { this.held = true; };
    this.range.oninput = () => this.move(this.sliderValue);
    this.range.onchange = () => {
      this.move(this.sliderValue, { resting: true, step: this.held ? "dragged" : "key" });
      this.held = false;
    };
    this.number.onchange = () => this.typed();
    this.back.onclick = () => {
      this.move(this.opened, { resting: true, step: "typed" });
      this.number.focus();
    };
  }

  get sliderValue() {
    return valueAt(this.spec, this.range.value / STEPS);
  }

  // Whether a number is being typed that has not been entered yet.
  get typing() {
    return document.activeElement === this.number && this.number.value !== this.text;
  }

  typed() {
    const text = this.number.value.trim().replace(",", ".");
    const value = text === "" && this.spec.optional ? null : Number(text || NaN);
    if (Number.isNaN(value)) {
      this.complain(`${this.spec.label}: "${this.number.value}" is no number: type one${this.spec.unit ? ` in ${this.spec.unit}` : ""}`);
      return;
    }
    this.move(value, { resting: true, step: "typed" });
  }

  move(value, how = {}) {
    this.complain("");
    this.set(value);
    this.moved(value, how);
  }

  // What the scene has taken: the slider makes room for a number that was typed beyond its ends.
  take(value) {
    if (this.typing) return;
    const { low, high, log } = this.spec;
    if (Number.isFinite(value) && low < high && (value > 0 || !log)) {
      this.spec = { ...this.spec, low: Math.min(low, value), high: Math.max(high, value) };
    }
    this.set(value);
  }

  // A value that follows from another one, unless a number is being typed here.
  follow(value) {
    if (value !== this.value && !this.typing) this.set(value);
  }

  set(value) {
    this.value = value;
    const off = value === null || value === undefined;
    const shown = off ? this.spec.start ?? this.spec.low : value;
    if (document.activeElement !== this.range || Math.abs(this.sliderValue - shown) > 1e-3 * Math.abs(shown)) {
      this.range.value = Math.round(STEPS * shareOf(this.spec, shown));
    }
    this.number.value = this.text = off ? "" : quantity(value);
    this.number.placeholder = off ? "none" : "";
    this.range.setAttribute("aria-valuetext", quantity(value, this.spec.unit));
    this.element.classList.toggle("off", off);
    if (this.stated) {
      this.stated.checked = !off;
      this.range.disabled = off;
    }
    const back = this.opened !== undefined && value !== this.opened;
    this.back.disabled = !back;
    label(this.back, `${this.spec.label} back to ${quantity(this.opened, this.spec.unit)}`);
    explain(this.back, back ? `back to ${quantity(this.opened, this.spec.unit)}` : "");
  }

  complain(words) {
    this.number.toggleAttribute("aria-invalid", Boolean(words));
    this.note ??= made("p", { className: "note", attributes: { role: "alert" } });
    this.note.textContent = words;
    if (words) this.element.append(this.note);
    else this.note.remove();
  }
}
