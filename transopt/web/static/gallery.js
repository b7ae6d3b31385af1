// Built-in scenes to begin from, each with its last tap, which is solved when the gallery is open.

import { drawSmall, penOf, SMALL_PX } from "./curves.js";
import { by, largest, made, write } from "./words.js";
import { came } from "./matrix.js";

export class Gallery {
  constructor(link, chosen) {
    Object.assign(this, { link, chosen, scenes: [], waiting: [], asked: false });
    by("scenes").onclick = () => {
      by("gallery").showModal();
      this.next();
    };
    by("gallery-close").onclick = () => by("gallery").close();
  }

  // No answer comes any more to what was asked.
  forget() {
    this.asked = false;
    this.next();
  }

  listed({ scenes }) {
    this.asked = false;
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

  // Asks for the list, then for one picture after the other: an answer is that to the one question that is open.
  next() {
    if (this.asked || !this.link.connected || !by("gallery").open || (this.scenes.length && !this.waiting.length)) return;
    this.asked = true;
    this.link.say(this.scenes.length ? { type: "glimpse", name: this.waiting[0].name } : { type: "gallery" });
  }

  glimpsed(message, taken) {
    this.asked = false;
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
