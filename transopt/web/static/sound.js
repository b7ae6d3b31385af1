// Hearing a tap: recorded, clipped, optimum, at one gain for all three.

import { Field } from "./field.js";
import { by } from "./words.js";

const PAUSE_S = 0.45;
const BEFORE_S = 0.03;

export class Sound {
  // `announce(words)`; `selected()`: index of the tap that is received.
  constructor(link, announce, selected) {
    Object.assign(this, { link, announce, selected, buffers: new Map(), gain_dB: 0, playing: [], wanted: null });
    for (const button of document.querySelectorAll("[data-sound]")) button.onclick = () => this.hear([button.dataset.sound]);
    by("compare").onclick = () => this.hear(["recorded", "optimum", "recorded", "optimum"]);
    const gain = new Field({ id: "gain", label: "loudness", unit: "dB", low: -40, high: 6, integer: true,
      tip: "of all three sounds alike, from -40 to 6 dB" }, (value) => this.loud(value));
    gain.set(0);
    by("gain-place").append(gain.element);
  }

  hear(names) {
    if (names.some((name) => this.buffers.has(name))) return this.play(names);
    this.wanted = names;
    return this.link.say({ type: "sound", tap: this.selected() });
  }

  received(message, arrays) {
    this.take(message.rate_Hz, arrays);
    if (this.wanted) this.play(this.wanted);
    this.wanted = null;
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

  // The named ones in turn, as far as there are such.
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
    this.announce(there.length ? `playing ${there.join(", then ")}` : "no certified optimum to hear");
  }
}
