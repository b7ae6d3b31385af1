// A user's own taps: looked at before they are sent, kept in the browser, and sent again to a server that lost them.

import { by, made, write } from "./words.js";

const MB = 2 ** 20;

function opened() {
  return new Promise((done, failed) => {
    const request = indexedDB.open("transopt page", 1);
    request.onupgradeneeded = () => request.result.createObjectStore("taps");
    request.onsuccess = () => done(request.result);
    request.onerror = () => failed(request.error);
  });
}

async function stored(mode, work) {
  try {
    const database = await opened();
    return await new Promise((done, failed) => {
      const request = work(database.transaction("taps", mode).objectStore("taps"));
      request.onsuccess = () => done(request.result);
      request.onerror = () => failed(request.error);
    });
  } catch {
    return undefined; // a browser that keeps nothing: the taps live as long as this window
  }
}

export class Taps {
  constructor(link, announce, complain) {
    Object.assign(this, { link, announce, complain, scene: null, kept: null, sending: null });
    by("files").onchange = () => {
      this.drop([...by("files").files]);
      by("files").value = "";
    };
    by("reset").onclick = () => {
      this.kept = null;
      sessionStorage.removeItem("own taps of");
      link.say({ type: "reset" });
    };
    by("bring").onclick = async () => this.send(await this.ofBefore());
    by("forget").onclick = async () => {
      await stored("readwrite", (taps) => taps.delete(this.scene.name));
      by("before").hidden = true;
    };
    addEventListener("dragover", (event) => {
      event.preventDefault();
      document.body.classList.add("dropping");
    });
    addEventListener("dragleave", () => document.body.classList.remove("dropping"));
    addEventListener("drop", (event) => {
      event.preventDefault();
      document.body.classList.remove("dropping");
      this.drop([...event.dataTransfer.files]);
    });
  }

  // Why files are not sent; empty for those that are.
  refusal(files) {
    const { bytes, files: most, suffixes } = this.scene.takes, size = files.reduce((sum, file) => sum + file.size, 0);
    const other = files.find((file) => !suffixes.some((suffix) => file.name.toLowerCase().endsWith(suffix)));
    if (files.length > most) return `${files.length} files: at most ${most} at once. Choose fewer`;
    if (other) return `${other.name}: no recording by its name: files of taps end in ${suffixes.join(", ")}`;
    if (size <= bytes) return "";
    const [largest] = [...files].sort((a, b) => b.size - a.size);
    return `${largest.name} has ${(largest.size / MB).toFixed(1)} MB${files.length > 1 ? `, all files ${(size / MB).toFixed(1)} MB` : ""}: `
      + `this page takes up to ${bytes / MB} MB at once. Cut the recording to its taps, or name it in a scene file `
      + "([recordings] files = [...]) and open that: transopt page SCENE.toml";
  }

  drop(files) {
    if (!files.length || !this.scene) return;
    const speed = by("speed").value.trim().replace(",", ".");
    const why = this.refusal(files) || (Number.isNaN(Number(speed)) ? `speed where a file states none: "${speed}" is no number: type one in m/s` : "");
    write(by("taps-answer"), why);
    by("taps-choices").replaceChildren();
    if (why) {
      this.complain(`Nothing was sent, and the page stays as it is. ${why}.`);
      this.announce("refused");
    } else this.send({ files, speed_m_s: Number(speed) || null, columns: by("columns").value, accept: by("accept").checked });
  }

  async send(taps) {
    if (!taps) return;
    this.sending = taps;
    this.announce("reading the files ...");
    const { files, ...fields } = taps;
    try {
      await this.link.sendFiles(files, { type: "drop", ...fields });
    } catch (error) {
      this.refused(`${files[0].name}: the browser cannot read it (${error.message}): choose it again`);
    }
  }

  // `choices`: what a file leaves open may be answered so, each with words and with how the files are then read.
  refused(words, choices = []) {
    const asked = this.sending;
    this.sending = null;
    write(by("taps-answer"), words);
    this.complain(words);
    by("taps-choices").replaceChildren(...choices.map((choice) => made("button", {
      type: "button", textContent: choice.words, onclick: () => this.send({ ...asked, reading: choice.reading }),
    })));
    by("taps-choices").firstElementChild?.focus();
  }

  // A scene is shown: with own taps they are kept, without they may be sent again. Returns whether they are.
  shown(scene, again) {
    this.scene = scene;
    if (scene.own.length) {
      if (this.sending) {
        this.kept = this.sending;
        stored("readwrite", (taps) => taps.put(this.kept, scene.name));
      }
      this.sending = null;
      sessionStorage.setItem("own taps of", scene.name);
    } else if (again && this.kept) {
      this.send(this.kept);
      return true;
    } else {
      this.kept = null;
    }
    by("taps-choices").replaceChildren();
    write(by("taps-answer"), scene.own.length ? `${scene.own.length} of yours: ${scene.own.join(", ")}. Kept in this browser.` : "");
    by("reset").hidden = !scene.own.length;
    by("before").hidden = true;
    if (!scene.own.length && scene.between) this.offer(scene);
    return false;
  }

  // In a window that had them they come back by themselves, in another one they are offered.
  async offer(scene) {
    const before = await this.ofBefore();
    if (!before || this.scene !== scene) return;
    if (sessionStorage.getItem("own taps of") === scene.name) {
      this.send(before);
      return;
    }
    by("before").hidden = false;
    write(by("bring"), `bring back ${before.files.length} of yours: ${before.files.map((file) => file.name).join(", ")}`);
  }

  ofBefore() {
    return stored("readonly", (taps) => taps.get(this.scene.name));
  }
}
