// Requests: the newest position of a hand is sent as soon as the server has room for it, those before are dropped.

const IN_FLIGHT = 2; // requests that the server may have at once: one is solved while the other is drawn,
const SLOW_MS = 50; // but one alone where an answer takes longer: what waits behind it is old when it comes
const RESTS_MS = 250; // after the last key or movement a slider is at rest

export class Asking {
  // `send(number, final)` sends what is asked for now; false where nothing can be sent.
  constructor(send) {
    Object.assign(this, { send, number: 0, takes: 0 });
    this.forget();
  }

  forget() {
    clearTimeout(this.timer);
    Object.assign(this, { pending: null, inFlight: 0, resting: false, began: new Map(), sent: new Map() });
  }

  want(began = performance.now()) {
    this.pending ??= began;
    this.resting = false;
    this.rest(RESTS_MS);
    this.flush();
  }

  flush(final = false) {
    if ((this.pending === null && !final) || this.inFlight >= (this.takes > SLOW_MS ? 1 : IN_FLIGHT)) return false;
    if (!this.send(this.number + 1, final)) return false;
    this.number += 1;
    this.inFlight += 1;
    this.began.set(this.number, this.pending ?? performance.now());
    this.sent.set(this.number, performance.now());
    this.pending = null;
    return true;
  }

  rest(after_ms) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      if (this.pending !== null || this.inFlight) this.rest(20);
      else if (!this.resting) this.resting = this.flush(true);
    }, after_ms);
  }

  // The server answers the newest: what was asked before it is answered with it. Returns when that began.
  done(number) {
    const began = this.began.get(number);
    this.inFlight = Math.max(this.number - number, 0);
    this.takes = performance.now() - (this.sent.get(number) ?? performance.now());
    for (const times of [this.began, this.sent]) for (const each of times.keys()) if (each <= number) times.delete(each);
    this.flush();
    return began;
  }
}
