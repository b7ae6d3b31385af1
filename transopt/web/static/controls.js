// Sliders and choices, made from the server's description of the scene's keys.

import { Field } from "./field.js";
import { made } from "./words.js";

const TITLES = {
  limits: "Limits", thermal: "Temperature", feedback: "Virtual wall", weights: "Weights", robust: "Spread of devices",
  amplifier: "Amplifier",
};

export class Sliders {
  // `changed(key, value, how)` is called as `moved` of a field.
  constructor(element, changed) {
    Object.assign(this, { element, changed, fields: new Map() });
  }

  // Creates the sliders of a scene that is opened.
  open(controls) {
    this.fields.clear();
    this.element.replaceChildren();
    for (const table of new Set(controls.map((control) => control.table))) {
      const group = made("details", { open: table === "limits" }, made("summary", { textContent: TITLES[table] || table }));
      for (const control of controls) if (control.table === table) group.append(this.row(control));
      this.element.append(group);
    }
  }

  row(control) {
    const { key } = control;
    const id = `of-${key}`, bounds = control.bounds && ` ${control.bounds} ${control.unit}`;
    const tip = `${control.about.replaceAll("`", "")}\n${key}${bounds}`.trim();
    const field = control.choices.length ? this.choice(control, id, tip)
      : new Field({ ...control, id, tip }, (value, how) => this.changed(key, value, how));
    field.element.dataset.key = key;
    field.opened = control.value;
    this.fields.set(key, field);
    field.set(control.value);
    return field.element;
  }

  choice(control, id, tip) {
    const choice = made("select", { id }, ...control.choices.map((word) => new Option(word, word)));
    const element = made("div", { className: "control", dataset: { tip } },
      made("label", { htmlFor: id, textContent: control.label }), choice);
    choice.onchange = () => this.changed(control.key, /^\d+$/.test(choice.value) ? Number(choice.value) : choice.value,
      { resting: true, step: "typed" });
    return { element, spec: control, set: (value) => { choice.value = String(value); },
      take: (value) => { choice.value = String(value); }, complain: () => undefined };
  }

  get(key) {
    return this.fields.get(key);
  }

  // Shows a scene with these changes; values that follow from them come with the server's answer.
  state(changes) {
    for (const [key, field] of this.fields) field.set(key in changes ? changes[key] : field.opened);
  }
}
