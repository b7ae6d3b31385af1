// Requests: every change is sent at once, and the server answers the newest that it has when it becomes free.

const RESTS_MS = 250; // after the last key or movement a slider is at rest
const BUSY_MS = 20; // at rest, while an answer is still on its way: look again after this time

export class Requests {
  // `send(number, final)` sends the present values; it returns false where nothing can be sent.
  constructor(send) {
    Object.assign(this, { send, number: 0 });
    this.forget();
  }

  forget() {
    clearTimeout(this.timer);
    Object.assign(this, { resting: false, began: new Map() });
  }

  want(began = performance.now()) {
    this.resting = false;
    this.rest(RESTS_MS);
    this.request(began, false);
  }

  request(began, final) {
    if (!this.send(this.number + 1, final)) return false;
    this.number += 1;
    this.began.set(this.number, began);
    return true;
  }

  rest(after_ms) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      if (this.began.size) this.rest(BUSY_MS);
      else if (!this.resting) this.resting = this.request(performance.now(), true);
    }, after_ms);
  }

  // An answer stands for all requests up to its own. Returns when the first of them began.
  done(number) {
    const answered = [...this.began].filter(([each]) => each <= number);
    for (const [each] of answered) this.began.delete(each);
    return answered.length ? Math.min(...answered.map(([, began]) => began)) : undefined;
  }
}
