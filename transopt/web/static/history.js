// Steps that can be undone.

const MOST = 100;
const SAME_MS = 700; // key presses on one slider that follow each other so soon are one step

export class History {
  constructor(changed) {
    this.changed = changed; // called with this when there is more or less to undo
    this.begin({});
  }

  begin(what) {
    Object.assign(this, { past: [], now: JSON.stringify(what), future: [], last: null });
    this.changed(this);
  }

  // `of` is the slider, `how` as of a field.
  note(what, of, how) {
    const text = JSON.stringify(what), at = performance.now();
    if (text === this.now) return;
    const goesOn = how === "key" && this.last?.of === of && this.last.how === how && at - this.last.at < SAME_MS;
    if (!goesOn) this.past.push(this.now);
    this.past = this.past.slice(-MOST);
    Object.assign(this, { now: text, future: [], last: { of, how, at } });
    this.changed(this);
  }

  // What the server has refused is no step.
  refuse(what) {
    if (JSON.stringify(what) === this.now && this.past.length) this.now = this.past.pop();
    this.last = null;
    this.changed(this);
  }

  undo() {
    return this.step(this.past, this.future);
  }

  redo() {
    return this.step(this.future, this.past);
  }

  step(from, to) {
    if (!from.length) return null;
    to.push(this.now);
    this.now = from.pop();
    this.last = null;
    this.changed(this);
    return JSON.parse(this.now);
  }
}
