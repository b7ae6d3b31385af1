// Hearing a tap: recorded, clipped, optimum, at one gain for all three.

const PAUSE_S = 0.45;
const BEFORE_S = 0.03;

export class Sound {
  constructor() {
    this.buffers = new Map();
    this.gain_dB = 0;
    this.playing = [];
  }

  forget() {
    this.buffers.clear();
  }

  take(rate_Hz, arrays) {
    this.context ??= new AudioContext();
    this.master ??= new GainNode(this.context);
    this.master.connect(this.context.destination);
    this.loud(this.gain_dB);
    for (const [name, samples] of Object.entries(arrays)) {
      const buffer = this.context.createBuffer(1, Math.max(samples.length, 1), rate_Hz);
      buffer.copyToChannel(samples, 0);
      this.buffers.set(name, buffer);
    }
  }

  loud(gain_dB) {
    this.gain_dB = gain_dB;
    if (this.master) this.master.gain.value = 10 ** (gain_dB / 20);
  }

  stop() {
    for (const source of this.playing) source.stop();
    this.playing = [];
  }

  // The named ones in turn; returns what of them there is.
  async play(names) {
    this.stop();
    await this.context.resume();
    const there = names.filter((name) => this.buffers.has(name));
    there.forEach((name, j) => {
      const source = new AudioBufferSourceNode(this.context, { buffer: this.buffers.get(name) });
      source.connect(this.master);
      source.start(this.context.currentTime + BEFORE_S + j * PAUSE_S);
      this.playing.push(source);
    });
    return there;
  }
}
