// Every tap as the device plays it on a warm coil, beside the optimum.

import { Field } from "./field.js";
import { by, percent, quantity } from "./words.js";

// Equal steps are equal ratios of what is left to the temperature that a transient may reach: the last tenth of a kelvin
// decides, of some seventy.
const LEAST_LEFT = 1e-4;

// What is played and its errors, in words; empty without a warm coil.
export function onWarmCoil({ warm }) {
  if (!warm) return "";
  if (!warm.figures || warm.scale === 0) return warm.words;
  return `${warm.words}: tap error ${percent(warm.figures.tap_error)} %, felt error ${percent(warm.figures.felt_error)} %, `
    + `${warm.figures.felt_dB.toFixed(2)} dB, ${warm.heat_A2_ms.toFixed(0)} A2ms`;
}

export class Warm {
  // `asks(temperature or null, how)`
  constructor(asks) {
    this.asks = asks;
    by("warm").onchange = () => this.asks(by("warm").checked ? this.field.value : null, { resting: true, step: "typed" });
  }

  open(windings_C, winding_C) {
    by("warmed").hidden = !windings_C;
    by("winding-place").replaceChildren();
    this.field = null;
    if (windings_C) {
      const [cold, hot] = windings_C;
      const at = (share) => Number((hot - (hot - cold) * LEAST_LEFT ** share).toFixed(3));
      const share = (value) => Math.min(Math.max(Math.log(Math.max(hot - value, 1e-9) / (hot - cold)) / Math.log(LEAST_LEFT), 0), 1);
      this.field = new Field({ id: "winding", label: "winding when the tap begins", unit: "C", low: cold, high: hot, at, share,
        tip: `temperature of the winding, from ambient to ${quantity(hot)} C, which no transient may pass; steps grow finer towards it` }, (value, how) => {
        by("warm").checked = true;
        this.asks(value, how);
      });
      this.field.set(winding_C ?? at(0.625));
      by("winding-place").append(this.field.element);
    }
    this.state(winding_C);
  }

  state(winding_C) {
    by("warm").checked = winding_C !== null;
    document.querySelector("#key .warm").hidden = winding_C === null;
    if (winding_C !== null) this.field?.set(winding_C);
  }
}
