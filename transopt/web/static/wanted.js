// The inverse question: the user states an error, and the server searches the limit that it requires.

import { Field } from "./field.js";
import { isLimited } from "./matrix.js";
import { by, percent, write } from "./words.js";

export class Wanted {
  // `sets(key, value)` takes an answer into the scene.
  constructor(link, sets) {
    Object.assign(this, { link, sets, tap: null, found: null });
    this.field = new Field({ id: "error", label: "tap error, at most", unit: "%", low: 0.1, high: 100, log: true,
      tip: "error of the selected tap that you can live with; the least value that has it is searched when the slider is released" }, (value, how) => {
      if (how.resting) this.ask(value);
    });
    this.field.set(25);
    by("error-place").append(this.field.element);
    by("error-set").onclick = () => this.take();
  }

  // After another change the answer is no longer valid.
  forget() {
    this.found = null;
    write(by("answer"), "");
    by("error-set").hidden = true;
  }

  // Searches the keys that change the error, when the page is at rest.
  look(tap, title) {
    if (!tap) return;
    if (title !== this.title) {
      by("error-key").replaceChildren(new Option("looking for what can move it ...", ""));
      this.forget();
    }
    Object.assign(this, { tap, title });
    if (!this.found && tap.certified) this.field.set(Number((100 * tap.figures.tap_error).toPrecision(3)));
    this.link.say({ type: "movers", tap: tap.index });
  }

  listed({ tap, movers }) {
    if (tap !== this.tap?.index) return;
    const choice = by("error-key"), before = choice.value;
    choice.replaceChildren(...movers.map(({ label, best, worst, key }) => new Option(
      `${label}: ${[...new Set([best, worst].map(percent))].join(" to ")} %`, key)));
    if (!movers.length) choice.append(new Option("nothing on this page moves it", ""));
    if (movers.some((mover) => mover.key === before)) choice.value = before;
    this.field.range.disabled = this.field.number.disabled = !movers.length;
    if (!this.found && this.tap.certified && !isLimited(this.tap)) {
      write(by("answer"), `Nothing need be done: ${this.title} is at its floor of ${percent(this.tap.floor)} %, and no limit holds it back.`);
    }
  }

  ask(value) {
    const key = by("error-key").value;
    if (!key || !this.tap) return;
    this.forget();
    write(by("answer"), "searching ...");
    this.link.say({ type: "ask", tap: this.tap.index, key, tap_error: value / 100 });
  }

  answered(message) {
    write(by("answer"), message.words);
    this.found = message.value === null ? null : message;
    by("error-set").hidden = !this.found || message.needed;
    if (this.found && message.needed) this.take();
  }

  take() {
    by("error-set").hidden = true;
    if (this.found) this.sets(this.found.key, this.found.value);
  }
}
