// Steps that can be undone; this window has them still when its page is loaded again.

const MOST = 100;
const SAME_MS = 700; // key presses on one slider that follow each other so soon are one step

export class History {
  // `name` tells the scene; `shown` is called with this when there is more or less to undo.
  constructor(what, name, shown) {
    Object.assign(this, { name, shown });
    this.begin(what);
  }

  changed() {
    this.shown(this);
    const { past, now, future } = this, name = this.name();
    if (name) sessionStorage.setItem("steps", JSON.stringify({ name, past, now, future }));
  }

  // The steps of before, if they are those of this scene.
  resume(name) {
    const { name: of, ...steps } = JSON.parse(sessionStorage.getItem("steps") || "{}");
    if (of === name) Object.assign(this, steps);
    this.changed();
  }

  // What is set, as far as the scene has it: own taps have none between them.
  present(scene) {
    const set = JSON.parse(this.now);
    return { ...set, probe: scene.between && set.probe, winding_C: scene.windings_C && set.winding_C };
  }

  begin(what) {
    Object.assign(this, { past: [], now: JSON.stringify(what), future: [], last: null });
    this.changed();
  }

  // `of` is the slider, `how` as of a field.
  note(what, of, how) {
    const text = JSON.stringify(what), at = performance.now();
    if (text === this.now) return;
    const goesOn = how === "key" && this.last?.of === of && this.last.how === how && at - this.last.at < SAME_MS;
    if (!goesOn) this.past.push(this.now);
    this.past = this.past.slice(-MOST);
    Object.assign(this, { now: text, future: [], last: { of, how, at } });
    this.changed();
  }

  // What the server has refused is no step.
  refuse(what) {
    if (JSON.stringify(what) === this.now && this.past.length) this.now = this.past.pop();
    this.last = null;
    this.changed();
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
    this.changed();
    return JSON.parse(this.now);
  }
}
