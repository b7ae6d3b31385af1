// The page: every input of the user becomes a request, and one answer updates all displays of a result.

import { Requests } from "./requests.js";
import { Between } from "./between.js";
import { Sliders } from "./controls.js";
import { Detail } from "./detail.js";
import { Gallery } from "./gallery.js";
import { Handle } from "./handle.js";
import { History } from "./history.js";
import { Link } from "./link.js";
import { Matrix } from "./matrix.js";
import { Sound } from "./sound.js";
import { Table } from "./table.js";
import { Taps } from "./taps.js";
import { Wanted } from "./wanted.js";
import { Warm, onWarmCoil } from "./warm.js";
import { by, write } from "./words.js";
import "./tips.js";

const NOTHING = { changes: {}, probe: null, winding_C: null };
const state = {
  scene: null, places: [], selected: 0,
  requested: NOTHING, // what the user has set: all that differs from the scene as it was opened
  accepted: NOTHING, // the same of the answer that is shown
  frame: null, // that answer: number, times, whole (first and last time of all samples), taps
  start: null, // the one of the scene as it was opened, with all its samples
  asOpened: true, // whether that is what is shown
  resume: false, chosen: "", moving: false, last: "",
};
const sentRequests = new Map();
const sliders = new Sliders(by("sliders"), change);
const between = new Between((probe, how) => ask({ probe }, "probe", how));
const warm = new Warm((winding_C, how) => ask({ winding_C }, "winding", how));
const matrix = new Matrix(by("cells"), select);
const table = new Table(by("table"), select);
const detail = new Detail(by("plot"), read);
const handle = new Handle(by("handle"), detail, change);
const link = new Link(received, connection);
const sound = new Sound(link, announce, () => state.selected);
const taps = new Taps(link, announce, complain);
const gallery = new Gallery(link, choose);
const wanted = new Wanted(link, (key, value) => {
  sliders.get(key)?.set(value);
  change(key, value, { resting: true, step: "typed", answers: true });
});
const history = new History(NOTHING, () => state.scene?.name, ({ past, future }) => {
  by("undo").disabled = !past.length;
  by("redo").disabled = !future.length;
});
const requests = new Requests((number, final) => {
  if (!state.scene || !link.connected) return false;
  sentRequests.set(number, state.requested);
  // While a slider moves, the samples that are looked at are enough.
  const view_s = final ? null : detail.view;
  link.say({ type: "change", id: number, ...state.requested, selected: state.selected, view_s, final });
  return true;
});

// ---- input of the user

function change(key, value, how) {
  const { [key]: _, [state.scene.rivals[key]]: __, ...others } = state.requested.changes;
  const opened = sliders.get(key).opened;
  ask({ changes: value === opened ? others : { ...others, [key]: value } }, key, how);
  if (key === state.scene.input_key) handle.place();
}

function ask(what, of, how = {}) {
  const probed = state.requested.probe;
  state.requested = { ...state.requested, ...what };
  if (!probed && state.requested.probe) state.selected = state.places.length;
  state.last = of;
  moves(!how.resting);
  if (how.step) history.note(state.requested, of, how.step);
  if (!how.answers) wanted.forget();
  solving();
  warm.state(state.requested.winding_C);
  requests.want();
  if (how.resting) requests.rest(0);
}

function moves(moving) {
  state.moving = moving;
  document.body.classList.toggle("moving", moving);
}

function restore(requested) {
  if (!requested) return;
  state.requested = history.present(state.scene);
  moves(false);
  state.last = "";
  showRequested();
  wanted.forget();
  solving();
  requests.want();
  requests.rest(0);
}

function showRequested() {
  sliders.state(state.requested.changes);
  between.state(state.requested.probe);
  warm.state(state.requested.winding_C);
  handle.place();
}

by("undo").onclick = () => restore(history.undo());
by("redo").onclick = () => restore(history.redo());
addEventListener("keydown", (event) => {
  if (!(event.ctrlKey || event.metaKey) || event.target.matches?.("input[type=text]")) return;
  const redo = event.key === "y" || (event.key.toLowerCase() === "z" && event.shiftKey);
  if (!redo && event.key !== "z") return;
  event.preventDefault();
  restore(redo ? history.redo() : history.undo());
});

function select(index) {
  if (index === state.selected || !state.places[index]) return;
  state.selected = index;
  sound.forget();
  marked();
  large();
  if (!state.moving) look();
}

function choose(name) {
  state.chosen = name;
  state.resume = false;
  announce("opening the scene ...");
  link.say({ type: "choose", name });
}

// ---- answers

function connection(connected) {
  document.body.classList.toggle("lost", !connected);
  by("banner").hidden = connected;
  requests.forget();
  gallery.forget();
  if (connected) {
    state.resume = Boolean(state.scene);
    announce("connected");
  } else {
    write(by("banner"), "The server does not answer. What you have set and your own taps are kept here. This page connects again by "
      + "itself when the server is back at this address; if the command was ended, start transopt page again and open the address "
      + "that it prints in this window.");
  }
}

function received(message, arrays) {
  const answers = {
    scene: opened, curves: drawn, settled, rested, refused, answer: (m) => { announce(""); wanted.answered(m); },
    movers: (m) => wanted.listed(m), gallery: (m) => gallery.listed(m), glimpse: (m, a) => gallery.glimpsed(m, taken(m, a)),
    progress: (m) => announce(`${m.words} ${m.of > 1 ? `${m.done} of ${m.of}` : "..."}`),
    sound: (m, a) => sound.received(m, a), file: saved,
  };
  answers[message.type](message, arrays);
}

function opened(scene) {
  const again = state.resume;
  link.scene = scene.number;
  if (again && state.chosen && scene.name !== state.chosen) {
    link.say({ type: "choose", name: state.chosen }); // the server began anew with another one
    return;
  }
  if (taps.shown(scene, again && scene.name === state.scene.name)) return; // they are sent again, and come with a scene
  const first = !state.scene, same = again && scene.name === state.scene.name;
  const dropped = !first && scene.own.length && scene.name === state.scene.name; // what is set stays set
  Object.assign(state, { scene, places: scene.places, frame: null, resume: false });
  moves(false);
  requests.forget();
  if (!same) {
    Object.assign(state, { start: null, selected: scene.own.length ? 0 : scene.places.length - 1 });
    if (first) history.resume(scene.name);
    else if (!dropped) history.begin(NOTHING);
    state.requested = history.present(scene);
  }
  state.accepted = NOTHING;
  document.title = `${scene.name} - transopt`;
  write(by("name"), scene.name);
  write(by("description"), scene.own.length ? `your own taps: ${scene.own.join(", ")}` : scene.description);
  complain(scene.remarks.join("; "));
  sliders.open(scene.controls);
  between.open(scene.between, state.requested.probe);
  warm.open(scene.windings_C, state.requested.winding_C);
  detail.open(scene);
  handle.open(scene, sliders.get(scene.input_key));
  sound.forget();
  placed(scene.places);
  showRequested();
  requests.want();
  requests.rest(0);
}

function placed(places) {
  state.places = places;
  state.selected = Math.min(state.selected, places.length - 1);
  matrix.open(places);
  table.open(state.scene, places);
  marked();
}

function taken(message, arrays) {
  const taps = new Map(message.taps.map((tap) => [String(tap.index), tap]));
  for (const [name, values] of Object.entries(arrays)) {
    const [index, own] = name.split(".");
    if (own) taps.get(index)[own] = values;
  }
  return arrays;
}

// One answer is the whole of what is shown.
function drawn(message, arrays) {
  taken(message, arrays);
  const frame = { number: message.id, times: arrays.times_s, whole: message.whole_s, taps: [] };
  for (const tap of message.taps) frame.taps[tap.index] = tap;
  state.frame = frame;
  state.accepted = sentRequests.get(message.id) ?? state.requested;
  for (const number of sentRequests.keys()) if (number <= message.id) sentRequests.delete(number);
  state.asOpened = JSON.stringify(state.accepted) === JSON.stringify(NOTHING);
  if (state.asOpened && covers(frame, frame.whole)) state.start = frame;
  if (JSON.stringify(message.places) !== JSON.stringify(state.places)) placed(message.places);
  sound.forget();
  // A late answer moves neither what is asked for now nor what was asked for then and has been taken back.
  const asked = { ...state.accepted.changes, ...state.requested.changes, [state.last]: null };
  for (const [key, value] of Object.entries(message.following)) if (!(key in asked)) sliders.get(key)?.follow(value);
  show(state.moving);
  requests.done(message.id);
}

function covers({ times }, [from, to]) {
  return times[0] <= from && times[times.length - 1] >= to;
}

function show(kept) {
  const { frame } = state;
  large(kept);
  matrix.show(frame, detail.view, detail.hidden, ghost());
  for (const tap of frame.taps) if (tap) table.show(tap, frame.number);
  certified();
}

// The scene as it was opened, where it is another one than what is shown.
function ghost() {
  return state.start && !state.asOpened && !detail.hidden.has("start") ? state.start : null;
}

function settled(message) {
  const tap = state.frame?.taps[message.tap.index];
  if (!tap || message.id !== state.frame.number) return;
  Object.assign(tap, message.tap);
  table.show(tap, message.id);
  matrix.caption(tap, message.id);
  if (tap.index === state.selected) about(tap);
}

function rested(message) {
  if (message.id !== requests.number) return;
  moves(false);
  for (const [key, value] of Object.entries(state.accepted.changes)) sliders.get(key)?.take(value);
  large();
  certified();
  look();
}

function look() {
  const tap = state.frame?.taps[state.selected];
  wanted.look(tap, state.places[state.selected]?.title);
}

function refused(message) {
  const { about: of, words, key, id } = message;
  if (of === "drop") {
    const again = state.resume;
    taps.refused(words, message.choices);
    if (again) {
      taps.kept = null;
      link.say({ type: "reset" });
    }
  } else if (of === "glimpse") {
    gallery.glimpsed(message, null);
    return;
  } else if (of === "change") {
    const newest = id === requests.number;
    requests.done(id);
    if (!newest) return; // what came since is answered too
    history.refuse(state.requested);
    state.requested = state.accepted;
    moves(false);
    showRequested();
    const field = sliders.get(key || state.last);
    if (field) field.complain(`${words}. It stays as it was.`);
    else complain(words);
    if (state.frame) {
      large();
      certified();
    } else {
      requests.want();
      requests.rest(0);
    }
    return;
  } else {
    complain(words);
  }
  if (of === "open") write(by("description"), words);
  if (of === "choose") state.chosen = "";
  if (of === "ask") write(by("answer"), words);
  announce(message.choices?.length ? "your answer is needed" : "refused");
}

function saved(message, arrays) {
  save(new Blob([arrays.body], { type: message.kind }), message.name);
}

function save(blob, name) {
  const place = URL.createObjectURL(blob);
  Object.assign(document.createElement("a"), { href: place, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(place), 10000);
  announce(`${name} saved`);
}

// ---- words

function solving() {
  if (by("state").textContent.includes("replayed")) announce("solving ...");
}

function announce(words) {
  write(by("state"), words);
}

function certified() {
  const all = state.frame.taps.filter(Boolean), fine = all.filter((tap) => tap.certified).length;
  const played = all.every((tap) => tap.replayed || !tap.certified);
  announce(`${fine} of ${all.length} certified${played && fine ? " and replayed" : ""}`);
  by("state").dataset.frame = state.frame.number;
}

let hiding = null;
function complain(words) {
  write(by("message-words"), words);
  by("message").hidden = !words;
  clearTimeout(hiding);
  hiding = setTimeout(() => { by("message").hidden = true; }, 20000);
}
by("message-close").onclick = () => { by("message").hidden = true; };

function read(words) {
  write(by("read"), words || "Point at the curves, or focus them and use the arrow keys, to read them.");
}

// ---- the selected tap

function marked() {
  matrix.select(state.selected);
  table.select(state.selected);
}

function large(kept = false) {
  const tap = state.frame?.taps[state.selected];
  if (!tap) return;
  const start = ghost();
  detail.show(state.frame, tap, start?.taps[tap.index] && { ...start.taps[tap.index], times: start.times }, kept);
  about(tap);
  handle.place();
}

function about(tap) {
  const place = state.places[tap.index], { cells } = tap, before = ghost()?.taps[tap.index]?.cells.tap;
  const was = before && before !== cells.tap ? ` (as opened ${before} %)` : "";
  const found = tap.certified ? `tap error ${cells.tap} %${was}, felt error ${cells.felt} %, floor ${cells.floor} %` : "";
  write(by("selected"), [[place.title, found].filter(Boolean).join(": "), onWarmCoil(tap)].filter(Boolean).join("; on the warm coil "));
  by("selected").dataset.frame = state.frame.number;
  by("reason").hidden = tap.certified;
  write(by("reason"), tap.certified ? "" : `Not shown: ${tap.reason}`);
  by("detail").classList.toggle("refused", !tap.certified);
  const sentences = [tap.verdict, `binding: ${cells.binding}`, tap.prices[0]?.sentence].filter(Boolean);
  write(by("binds"), tap.certified ? sentences.map((words) => `${words[0].toUpperCase()}${words.slice(1)}.`).join(" ") : "");
}

// ---- curves that are shown, time that is looked at, saving

for (const button of document.querySelectorAll("[data-curve]")) {
  button.onclick = () => {
    const shown = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(shown));
    if (shown) detail.hidden.delete(button.dataset.curve);
    else detail.hidden.add(button.dataset.curve);
    if (state.frame) show(true);
  };
}
const looks = {
  first: () => detail.first(), whole: () => detail.zoom(...detail.whole), nearer: () => detail.scale(1 / 1.5),
  wider: () => detail.scale(1.5), earlier: () => detail.shift(-0.5), later: () => detail.shift(0.5),
};
for (const button of document.querySelectorAll("[data-look]")) {
  button.onclick = () => { if (state.frame) looks[button.dataset.look](); };
}
detail.zoomed = () => {
  matrix.show(state.frame, detail.view, detail.hidden, ghost());
  const [from, to] = detail.view.map((t) => Number((1e3 * t).toFixed(1)));
  write(by("looked-at"), `${from} to ${to} ms`);
  if (!covers(state.frame, detail.view)) requests.want();
};
for (const button of document.querySelectorAll("[data-save]")) {
  button.onclick = () => link.say({ type: "save", what: button.dataset.save });
}
for (const button of document.querySelectorAll("[data-figure]")) {
  button.onclick = async () => {
    const kind = button.dataset.figure, title = `${state.scene.name}, ${by("selected").textContent}`;
    save(await detail.file(kind, title), `${state.scene.name}.${kind}`);
  };
}

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { if (state.frame) show(false); });
read("");
globalThis.page = state; // read by tests and by scripts/page_speed.py
