// One additional tap, at any speed and grip between the nodes.

import { Field } from "./field.js";
import { by } from "./words.js";

const AXES = [["speed_m_s", "speed", "m/s"], ["grip_N", "grip", "N"]];

export class Between {
  // `asks([speed, grip] or null, how)`
  constructor(asks) {
    this.asks = asks;
    by("probe").onchange = () => this.asks(by("probe").checked ? this.here : null, { resting: true, step: "typed" });
  }

  open(between, probe) {
    by("between").hidden = !between;
    by("probes").replaceChildren();
    this.fields = between ? AXES.map(([key, label, unit], j) => {
      const [low, high] = between[key];
      const spec = { id: `probe-${key}`, label, unit, low, high, tip: `${label} of a tap between the nodes, ${low} to ${high} ${unit}; solved for its own blend of the recordings` };
      const field = new Field(spec, (value, how) => {
        if (!Number.isFinite(value) || value < low || value > high) {
          field.complain(`${label} ${value} ${unit}: outside of the recorded ones, ${low} to ${high} ${unit}`);
          return;
        }
        by("probe").checked = true;
        this.asks(this.here, how);
      });
      field.set(probe?.[j] ?? Number(((low + high) / 2).toPrecision(3)));
      field.range.disabled = low === high;
      by("probes").append(field.element);
      return field;
    }) : [];
    this.state(probe);
  }

  get here() {
    return this.fields.map((field) => field.value);
  }

  state(probe) {
    by("probe").checked = Boolean(probe);
    if (probe) this.fields.forEach((field, j) => field.set(probe[j]));
  }
}
