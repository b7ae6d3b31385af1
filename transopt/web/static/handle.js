// The handle of the limit in the plot. It shows the value that the user has set, by dragging or by the arrow keys.

import { quantity, write } from "./words.js";

const FACTORS = { ArrowUp: 1.02, ArrowRight: 1.02, ArrowDown: 1 / 1.02, ArrowLeft: 1 / 1.02, PageUp: 1.2, PageDown: 1 / 1.2 };

export class Handle {
  // `changed(key, value, how)`, as of a slider.
  constructor(element, detail, changed) {
    Object.assign(this, { element, detail, changed, field: null });
    element.onpointerdown = (event) => {
      element.setPointerCapture(event.pointerId);
      event.stopPropagation();
    };
    element.onpointermove = (event) => {
      if (!element.hasPointerCapture(event.pointerId)) return;
      this.move(detail.inputAt(event.clientY - detail.element.getBoundingClientRect().top));
    };
    element.onpointerup = () => this.move(this.field.value, { resting: true, step: "dragged" });
    element.onkeydown = (event) => {
      if (!FACTORS[event.key]) return;
      event.preventDefault();
      this.move(this.field.value * FACTORS[event.key], { step: "key" });
    };
  }

  open(scene, field) {
    Object.assign(this, { key: scene.input_key, field });
  }

  move(value, how = {}) {
    const { low, high } = this.field.spec;
    const inside = Number(Math.min(Math.max(value, low), high).toPrecision(3));
    this.field.set(inside);
    this.changed(this.key, inside, how);
  }

  // Position and text.
  place() {
    const { element, field } = this, y = field && this.detail.inputY(field.value);
    element.hidden = y === undefined || field.value === null;
    if (element.hidden) return;
    const { top, bottom } = this.detail.panels.input, text = quantity(field.value, field.spec.unit);
    element.style.top = `${Math.min(Math.max(y, top), bottom)}px`;
    write(element.firstElementChild, text);
    element.setAttribute("aria-label", `limit of the ${field.spec.label} in the plot`);
    for (const [name, now] of [["min", field.spec.low], ["max", field.spec.high], ["now", field.value], ["text", text]]) {
      element.setAttribute(`aria-value${name}`, now);
    }
  }
}
