// Built-in scenes to begin from, each with its last tap, which is solved when the gallery is open.

import { drawSmall, penOf, SMALL_PX } from "./curves.js";
import { by, largest, made, write } from "./words.js";
import { came } from "./matrix.js";

export class Gallery {
  constructor(link, chosen) {
    Object.assign(this, { link, chosen, scenes: [], waiting: [] });
    by("scenes").onclick = () => {
      by("gallery").showModal();
      if (!this.scenes.length) link.say({ type: "gallery" });
      else this.next();
    };
    by("gallery-close").onclick = () => by("gallery").close();
  }

  listed({ scenes }) {
    this.scenes = scenes.map((scene) => {
      const card = made("button", { type: "button", className: "cell card" }, made("strong", { textContent: scene.name }), made("canvas"),
        made("span", { className: "came", textContent: "..." }), made("span", { textContent: scene.description }));
      card.onclick = () => {
        by("gallery").close();
        this.chosen(scene.name);
      };
      by("cards").append(card);
      return { ...scene, card };
    });
    this.waiting = [...this.scenes];
    this.next();
  }

  next() {
    if (this.waiting.length && by("gallery").open) this.link.say({ type: "glimpse", name: this.waiting[0].name });
  }

  glimpsed(message, taken) {
    const [scene] = this.waiting.splice(0, 1);
    if (!scene) return;
    if (taken) {
      const [tap] = message.taps, { times_s: times } = taken;
      const scale = { view: [times[0], Math.min(times[times.length - 1], message.window_end_s)], acceleration: largest(tap.recorded_m_s2), input: tap.input_limit };
      const canvas = scene.card.querySelector("canvas"), width = canvas.clientWidth;
      drawSmall(penOf(canvas, width, SMALL_PX), { x: 0, y: 0, width }, times, tap, scale);
      write(scene.card.querySelector(".came"), came(tap));
    } else {
      write(scene.card.querySelector(".came"), "needs recordings that are not here");
      scene.card.dataset.tip = message.words;
    }
    this.next();
  }
}
