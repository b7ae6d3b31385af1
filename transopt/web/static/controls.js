// Sliders and choices, made from what the server says of the scene's keys.

const STEPS = 400;

export function shareOf(control, value) {
  if (control.log) return Math.log(value / control.low) / Math.log(control.high / control.low);
  return (value - control.low) / (control.high - control.low);
}

export function valueAt(control, share) {
  const value = control.log ? control.low * (control.high / control.low) ** share
    : control.low + share * (control.high - control.low);
  const rounded = control.integer ? Math.round(value) : Number(value.toPrecision(3));
  return Math.min(Math.max(rounded, control.low), control.high);
}

export function said(value, unit) {
  if (value === null || value === undefined) return "not stated";
  const text = typeof value === "number" ? String(Number(value.toPrecision(4))) : value;
  return unit ? `${text} ${unit}` : text;
}

const TITLES = {
  limits: "Limits", thermal: "Temperature", feedback: "Virtual wall", weights: "Weights", robust: "Spread of devices",
  amplifier: "Amplifier",
};

export class Sliders {
  // `changed(key, value, resting)` whenever one moves.
  constructor(element, changed) {
    this.element = element;
    this.changed = changed;
    this.rows = new Map();
  }

  // Made anew for another set of keys, else only brought up to date: a slider keeps the focus and the hand.
  show(controls) {
    const keys = controls.map((control) => control.key).join();
    if (keys !== this.keys) {
      this.keys = keys;
      this.rows.clear();
      this.element.replaceChildren();
      for (const table of new Set(controls.map((control) => control.table))) {
        const group = document.createElement("details");
        group.open = table === "limits";
        const title = document.createElement("summary");
        title.textContent = TITLES[table] || table;
        group.append(title);
        group.title = controls.find((control) => control.table === table).about;
        for (const control of controls) if (control.table === table) group.append(this.row(control));
        this.element.append(group);
      }
    }
    for (const control of controls) this.update(control);
  }

  row(control) {
    const row = document.createElement("div");
    row.className = "control";
    row.dataset.key = control.key;
    const id = `of-${control.key}`;
    const name = document.createElement("label");
    name.htmlFor = id;
    name.textContent = control.label;
    name.title = `${control.key} ${control.bounds}`;
    const entry = { row, control, name };
    row.append(name);
    if (control.choices.length) {
      const choice = document.createElement("select");
      choice.id = id;
      for (const word of control.choices) choice.append(new Option(word, word));
      choice.onchange = () => this.moved(entry, /^\d+$/.test(choice.value) ? Number(choice.value) : choice.value, true);
      entry.choice = choice;
      row.append(choice);
    } else {
      const output = document.createElement("output");
      output.htmlFor = id;
      const range = document.createElement("input");
      Object.assign(range, { type: "range", id, min: 0, max: STEPS, step: 1 });
      if (control.optional) {
        const stated = document.createElement("input");
        Object.assign(stated, { type: "checkbox" });
        stated.setAttribute("aria-label", `state ${control.label}`);
        stated.onchange = () => {
          const value = stated.checked ? valueAt(entry.control, range.value / STEPS) : null;
          this.moved(entry, value, true);
        };
        name.prepend(stated, " ");
        entry.stated = stated;
      }
      range.oninput = (event) => this.moved(entry, valueAt(entry.control, range.value / STEPS), false, event.timeStamp);
      range.onchange = () => this.moved(entry, valueAt(entry.control, range.value / STEPS), true);
      Object.assign(entry, { output, range });
      row.append(output, range);
    }
    this.rows.set(control.key, entry);
    return row;
  }

  moved(entry, value, resting, began) {
    this.set(entry.control.key, value);
    this.complain(entry.control.key, "");
    this.changed(entry.control.key, value, resting, began);
  }

  update(control) {
    const entry = this.rows.get(control.key);
    if (document.activeElement === entry.range && entry.control.low) {
      control = { ...control, low: entry.control.low, high: entry.control.high }; // the slider in hand does not jump
    }
    entry.control = control;
    entry.name.title = `${control.key} ${control.bounds}`;
    this.set(control.key, control.value);
  }

  set(key, value) {
    const entry = this.rows.get(key);
    if (!entry) return;
    entry.value = value;
    if (entry.choice) {
      entry.choice.value = String(value);
      return;
    }
    const shown = value === null || value === undefined ? entry.control.start : value;
    if (document.activeElement !== entry.range || Math.abs(valueAt(entry.control, entry.range.value / STEPS) - shown) >
        1e-3 * Math.abs(shown)) {
      entry.range.value = Math.round(STEPS * shareOf(entry.control, shown));
    }
    entry.output.textContent = said(value, entry.control.unit);
    entry.range.setAttribute("aria-valuetext", said(value, entry.control.unit));
    entry.row.classList.toggle("off", value === null || value === undefined);
    if (entry.stated) {
      entry.stated.checked = value !== null && value !== undefined;
      entry.range.disabled = !entry.stated.checked;
    }
  }

  complain(key, words) {
    const entry = this.rows.get(key);
    if (!entry) return;
    let note = entry.row.querySelector(".note");
    if (!words) {
      if (note) note.remove();
      return;
    }
    if (!note) {
      note = document.createElement("p");
      note.className = "note";
      note.setAttribute("role", "alert");
      entry.row.append(note);
    }
    note.textContent = words;
  }
}
