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
    Object.assign(this, { resting: false, sent: new Set() });
  }

  want() {
    this.resting = false;
    this.rest(RESTS_MS);
    this.request(false);
  }

  request(final) {
    if (!this.send(this.number + 1, final)) return false;
    this.number += 1;
    this.sent.add(this.number);
    return true;
  }

  rest(after_ms) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      if (this.sent.size) this.rest(BUSY_MS);
      else if (!this.resting) this.resting = this.request(true);
    }, after_ms);
  }

  // An answer stands for all requests up to its own.
  done(number) {
    for (const each of this.sent) if (each <= number) this.sent.delete(each);
  }
}
