// The page: what the hand does becomes requests, what the server answers is drawn and said.

import { Link } from "./link.js";
import { Detail, colours, drawSmall } from "./plots.js";
import { Sliders, said, shareOf, valueAt } from "./controls.js";
import { Sound } from "./sound.js";

const IN_FLIGHT = 2; // requests that the server may have at once: one is solved while the other is drawn,
const SLOW_MS = 50; // but one alone where an answer takes longer: what waits behind it is old when it comes
const RESTS_MS = 250; // after the last key or movement a slider is at rest
const TABLE_MS = 300; // between two states of the table while something is dragged
const STEPS = 400;
const by = (id) => document.getElementById(id);

const state = {
  scene: null, places: [], taps: [], times: null, selected: 0, changes: {}, kept: {}, probe: null, winding_C: null,
  pending: null, inFlight: 0, number: 0, began: new Map(), sent: new Map(), takes: 0, rest: null, resting: false, wantSound: null, resume: false,
};
const sound = new Sound();
let detail = null;
const sliders = new Sliders(by("sliders"), moved);
const link = new Link(heard, there);

// ---- requests

function moved(key, value, resting, began) {
  want({ [key]: value }, began);
  if (resting) rest(0);
}

// The newest values are sent as soon as the server has room for them; those before are dropped.
function want(changes, began = performance.now()) {
  state.kept = { ...state.kept, ...changes };
  if (state.scene && !state.scene.between) state.probe = null;
  state.pending ??= { changes: {}, began };
  Object.assign(state.pending.changes, changes);
  state.resting = false;
  if (by("state").textContent.includes("replayed")) tell("solving ...");
  rest(RESTS_MS);
  flush();
}

function flush(final = false) {
  if (!state.scene || !link.connected || (!state.pending && !final) || state.inFlight >= (state.takes > SLOW_MS ? 1 : IN_FLIGHT)) return false;
  const pending = state.pending ?? { changes: {}, began: performance.now() };
  state.pending = null;
  state.number += 1;
  state.inFlight += 1;
  state.began.set(state.number, pending.began);
  state.sent.set(state.number, performance.now());
  link.say({ type: "change", id: state.number, changes: pending.changes, selected: state.selected, probe: state.probe, winding_C: state.winding_C, final });
  return true;
}

function rest(after_ms) {
  clearTimeout(state.rest);
  state.rest = setTimeout(() => {
    if (state.pending || state.inFlight) return rest(20);
    if (!state.resting) state.resting = flush(true);
  }, after_ms);
}

// ---- answers

function there(connected) {
  document.body.classList.toggle("lost", !connected);
  const banner = by("banner");
  banner.hidden = connected;
  if (connected) {
    state.resume = Boolean(state.scene);
    state.inFlight = 0;
    state.pending = null;
    state.began.clear();
    tell("connected");
  } else {
    banner.textContent = "The server does not answer. This page connects again by itself when it is back at this address; if it was "
      + "ended, start transopt page again and open the address that it prints.";
  }
}

function heard(message, arrays) {
  const answers = {
    scene: opened, places: (m) => { state.places = m.places; cells(); rows(); }, curves: drawn, settled, rested, refused,
    progress: (m) => tell(`${m.words} ${m.of > 1 ? `${m.done} of ${m.of}` : "..."}`),
    answer: answered, sound: sounded, file: saved,
  };
  answers[message.type](message, arrays);
}

function opened(scene) {
  const again = state.resume && state.scene && state.scene.name === scene.name;
  const kept = again ? state.kept : {};
  Object.assign(state, { scene, places: scene.places, taps: [], kept, resume: false, pending: null, inFlight: 0 });
  if (!again) Object.assign(state, { probe: null, winding_C: null, selected: scene.own.length ? 0 : start(scene) });
  sound.forget();
  document.title = `${scene.name} - transopt`;
  by("name").textContent = scene.name;
  by("description").textContent = scene.own.length ? `your own taps: ${scene.own.join(", ")}` : scene.description;
  by("reset").hidden = !scene.own.length;
  by("probe").checked = Boolean(state.probe);
  detail = new Detail(by("plot"), scene.driven_by.name, scene.driven_by.unit);
  if (scene.remarks.length) complain(scene.remarks.join("; "));
  sliders.show(scene.controls);
  keysOfError(scene.controls);
  probes();
  warmed();
  cells();
  rows();
  for (const [key, value] of Object.entries(kept)) sliders.set(key, value);
  want(kept);
  rest(0);
}

// The last tap is the fastest at the firmest grip: where limits bind.
function start(scene) {
  return scene.places.length - 1;
}

function drawn(message, arrays) {
  const first = !state.times || !state.taps.length;
  state.times = arrays.times_s;
  const colour = colours();
  for (const tap of message.taps) {
    const own = (name) => arrays[`${tap.index}.${name}`];
    const before = state.taps[tap.index];
    for (const name of ["recorded_m_s2", "optimum_m_s2", "clipped_m_s2", "input", "clipped_input", "temperature_C",
      "warm_m_s2", "warm_input"]) {
      tap[name] = own(name);
    }
    tap.ends = state.scene.window_end_s;
    tap.window = Math.round((tap.ends - state.times[0]) / (state.times[1] - state.times[0]));
    state.taps[tap.index] = tap;
    if (tap.index === state.selected) large(first || !before);
    small(tap, colour);
  }
  later();
  sound.forget();
  if (!message.last) return;
  const began = state.began.get(message.id);
  done(message.id);
  flush();
  // The frame that is drawn after this: what the eye sees of the event that began it.
  requestAnimationFrame(() => {
    if (began !== undefined) performance.measure("slider to frame", { start: began, end: performance.now() });
  });
  tellCertified();
}

// The server answers the newest: what was asked before it is answered with it.
function done(number) {
  state.inFlight = state.number - number;
  state.takes = performance.now() - (state.sent.get(number) ?? performance.now());
  for (const times of [state.began, state.sent]) for (const each of times.keys()) if (each <= number) times.delete(each);
}

function settled(message) {
  const shown = message.tap;
  const tap = state.taps[shown.index];
  if (!tap || message.id !== state.number) return;
  const certified = tap.certified;
  Object.assign(tap, shown);
  row(tap);
  caption(tap);
  if (tap.index === state.selected) {
    about(tap);
    if (certified !== tap.certified) handle();
  }
}

function rested(message) {
  if (message.id !== state.number) return;
  sliders.show(message.controls);
  keysOfError(message.controls);
  state.scene.controls = message.controls;
  large(true);
  tellCertified();
}

function refused(message) {
  if (message.about === "change") done(message.id);
  const key = Object.keys(state.kept).find((each) => message.words.includes(each));
  complain(message.words);
  if (message.about === "change" && key) sliders.complain(key, message.words);
  if (message.about === "open") by("description").textContent = message.words;
  if (message.about === "ask") by("answer").textContent = message.words;
  tell("refused");
  flush();
}

function answered(message) {
  by("answer").textContent = message.words;
  tell("");
  if (message.value === null) return;
  sliders.set(message.key, message.value);
  want({ [message.key]: message.value });
  rest(0);
}

function saved(message, arrays) {
  const place = URL.createObjectURL(new Blob([arrays.body], { type: message.kind }));
  const save = document.createElement("a");
  Object.assign(save, { href: place, download: message.name });
  save.click();
  setTimeout(() => URL.revokeObjectURL(place), 10000);
  tell(`${message.name} saved`);
}

// ---- words

function tell(words) {
  if (by("state").textContent !== words) by("state").textContent = words;
}

function tellCertified() {
  const taps = state.taps.filter(Boolean);
  const fine = taps.filter((tap) => tap.certified).length;
  const played = taps.every((tap) => tap.replayed || !tap.certified);
  tell(`${fine} of ${taps.length} certified${played && fine ? " and replayed" : ""}`);
}

let hiding = null;
function complain(words) {
  const message = by("message");
  message.textContent = words;
  message.hidden = false;
  clearTimeout(hiding);
  hiding = setTimeout(() => { message.hidden = true; }, 12000);
}

function percent(share) {
  return share === null || share === undefined ? "-" : (100 * share).toFixed(1);
}

function came(tap) {
  if (!tap) return "...";
  if (!tap.certified) return "refused";
  const error = tap.figures.tap_error;
  return `${percent(error)} %${error > 1.05 * tap.floor ? ", limited" : ""}`;
}

// What is played on a coil as warm as is asked for, and how near that comes; empty where nothing is asked.
function onWarmCoil(tap) {
  const { warm } = tap;
  if (!warm) return "";
  if (!warm.figures || warm.scale === 0) return warm.words;
  return `${warm.words}: tap error ${percent(warm.figures.tap_error)} %, felt error ${percent(warm.figures.felt_error)} %, `
    + `${warm.figures.felt_dB.toFixed(2)} dB, ${warm.heat_A2_ms.toFixed(0)} A2ms`;
}

// ---- the small plots

function cells() {
  const all = by("cells");
  all.replaceChildren(...state.places.map((place, index) => {
    const cell = document.createElement("button");
    Object.assign(cell, { type: "button", className: "cell", title: place.title });
    cell.setAttribute("role", "option");
    const canvas = document.createElement("canvas");
    const name = document.createElement("span");
    Object.assign(name, { className: "place", textContent: place.between ? `between: ${place.title}` : place.title });
    const result = document.createElement("span");
    Object.assign(result, { className: "came", textContent: "..." });
    cell.append(name, canvas, result);
    cell.onclick = () => select(index);
    return cell;
  }));
  marked();
}

function marked() {
  [...by("cells").children].forEach((cell, index) => {
    cell.setAttribute("aria-selected", String(index === state.selected));
    cell.tabIndex = index === state.selected ? 0 : -1;
  });
  [...by("table").tBodies[0].rows].forEach((line, index) => line.setAttribute("aria-selected", String(index === state.selected)));
}

function small(tap, colour) {
  const cell = by("cells").children[tap.index];
  if (!cell) return;
  drawSmall(cell.querySelector("canvas"), state.times, tap, colour, tap.ends);
  caption(tap);
}

function caption(tap) {
  const cell = by("cells").children[tap.index];
  if (!cell) return;
  cell.classList.toggle("refused", !tap.certified);
  cell.querySelector(".came").textContent = came(tap);
  cell.setAttribute("aria-label", `${state.places[tap.index].title}: ${came(tap)}`);
}

by("cells").addEventListener("keydown", (event) => {
  const steps = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 };
  const last = state.places.length - 1;
  const index = event.key === "Home" ? 0 : event.key === "End" ? last : state.selected + (steps[event.key] || NaN);
  if (Number.isNaN(index)) return;
  event.preventDefault();
  select(Math.min(Math.max(index, 0), last));
  by("cells").children[state.selected].focus();
});

function select(index) {
  if (index === state.selected) return;
  state.selected = index;
  sound.forget();
  marked();
  large(true);
}

// ---- the large plot and the limit in it

function large(anew) {
  const tap = state.taps[state.selected];
  if (!tap || !tap.input) return;
  detail.draw(state.times, tap, anew);
  about(tap);
  handle();
}

function about(tap) {
  const place = state.places[tap.index];
  const found = tap.certified ? `tap error ${percent(tap.figures.tap_error)} %, felt error ${percent(tap.figures.felt_error)} %, floor ${percent(tap.floor)} %` : "";
  by("selected").textContent = [[place.title, found].filter(Boolean).join(": "), onWarmCoil(tap)].filter(Boolean).join("; on the warm coil ");
  by("reason").hidden = tap.certified;
  by("reason").textContent = tap.certified ? "" : `Not shown: ${tap.reason}`;
  by("detail").classList.toggle("refused", !tap.certified);
}

function handle() {
  const grip = by("handle"), tap = state.taps[state.selected], line = detail.line;
  const control = (state.scene.controls || []).find((each) => each.key === state.scene.input_key);
  grip.hidden = !line || !control;
  if (grip.hidden) return;
  Object.assign(grip.style, {
    left: `${line.left}px`, width: `${line.width}px`, top: `${line.axis._offset + line.axis.l2p(tap.input_limit)}px`,
  });
  grip.firstElementChild.textContent = said(tap.input_limit, control.unit);
  grip.setAttribute("aria-label", `limit of the ${control.label} in the plot`);
  grip.setAttribute("aria-valuemin", control.low);
  grip.setAttribute("aria-valuemax", control.high);
  grip.setAttribute("aria-valuenow", tap.input_limit);
  grip.setAttribute("aria-valuetext", said(tap.input_limit, control.unit));
}

function limited(value, resting, began) {
  const control = state.scene.controls.find((each) => each.key === state.scene.input_key);
  const inside = Number(Math.min(Math.max(value, control.low), control.high).toPrecision(3));
  sliders.set(control.key, inside);
  moved(control.key, inside, resting, began);
}

by("handle").addEventListener("pointerdown", (event) => by("handle").setPointerCapture(event.pointerId));
by("handle").addEventListener("pointermove", (event) => {
  if (!by("handle").hasPointerCapture(event.pointerId)) return;
  const { axis } = detail.line;
  limited(axis.p2l(event.clientY - by("plot").getBoundingClientRect().top - axis._offset), false, event.timeStamp);
});
by("handle").addEventListener("pointerup", () => rest(0));
by("handle").addEventListener("keydown", (event) => {
  const factors = { ArrowUp: 1.02, ArrowRight: 1.02, ArrowDown: 1 / 1.02, ArrowLeft: 1 / 1.02, PageUp: 1.2, PageDown: 1 / 1.2 };
  if (!factors[event.key]) return;
  event.preventDefault();
  limited(state.taps[state.selected].input_limit * factors[event.key], false, event.timeStamp);
});

// ---- the table

function rows() {
  const table = by("table");
  const columns = ["tap %", "floor %", "clipped %", "felt %", "felt dB", "speed", "bump g", "heat A2ms", "what binds", "price",
    ...(state.scene.windings_C ? ["on the warm coil"] : []), "state"];
  const line = table.tHead.insertRow ? table.tHead : table.createTHead();
  line.replaceChildren();
  const head = line.insertRow();
  for (const name of [...state.scene.columns, ...columns]) {
    const cell = document.createElement("th");
    Object.assign(cell, { scope: "col", textContent: name });
    head.append(cell);
  }
  table.tBodies[0].replaceChildren();
  state.places.forEach((place, index) => {
    const own = table.tBodies[0].insertRow();
    const names = place.target ? [place.target] : [place.speed_m_s, place.grip_N].map((v) => String(Number(v.toPrecision(4))));
    for (const name of names) own.insertCell().textContent = name;
    columns.forEach((_, j) => { own.insertCell().className = j < 8 ? "number" : "words"; });
    own.onclick = () => select(index);
    if (state.taps[index]) row(state.taps[index]);
  });
  marked();
}

// A table is laid out anew with every word in it: while something is dragged, only now and then.
let waiting = null;
function later() {
  waiting ??= setTimeout(() => {
    waiting = null;
    for (const tap of state.taps) if (tap) row(tap);
  }, TABLE_MS);
}

function row(tap) {
  const line = by("table").tBodies[0].rows[tap.index];
  if (!line) return;
  line.classList.toggle("refused", !tap.certified);
  const fixed = (value, digits) => (value === null || value === undefined ? "-" : value.toFixed(digits));
  const figures = tap.figures ?? {};
  const words = [
    percent(figures.tap_error), percent(tap.floor), percent(tap.clipped), percent(figures.felt_error),
    fixed(figures.felt_dB, 2), fixed(figures.speed, 2), fixed(figures.bump_m_s2 && figures.bump_m_s2 / 9.80665, 2),
    fixed(tap.heat_A2_ms, 0), tap.binds || "-", tap.price || "-",
    ...(state.scene.windings_C ? [onWarmCoil(tap) || "-"] : []),
    tap.certified ? (tap.replayed ? `certified, replayed; ${tap.verdict}` : "certified") : tap.reason,
  ];
  const from = state.scene.columns.length;
  words.forEach((text, j) => {
    const cell = line.cells[from + j];
    if (cell.textContent !== text) cell.textContent = text;
  });
}

// ---- between the nodes

const PROBES = [["speed_m_s", "speed", "m/s"], ["grip_N", "grip", "N"]];

function probes() {
  const { between } = state.scene;
  by("between").hidden = !between;
  by("probes").replaceChildren();
  if (!between) return;
  PROBES.forEach(([key, label, unit], j) => {
    const [low, high] = between[key];
    const row = document.createElement("div");
    row.className = "control";
    const name = document.createElement("label");
    Object.assign(name, { htmlFor: `probe-${key}`, textContent: label });
    const output = document.createElement("output");
    const range = document.createElement("input");
    Object.assign(range, { type: "range", id: `probe-${key}`, min: 0, max: STEPS, value: STEPS / 2, disabled: low === high });
    const value = () => Number((low + (range.value / STEPS) * (high - low)).toPrecision(4));
    const show = () => {
      output.textContent = said(value(), unit);
      range.setAttribute("aria-valuetext", said(value(), unit));
    };
    if (state.probe) range.value = Math.round(STEPS * (state.probe[j] - low) / (high - low || 1));
    range.oninput = (event) => { show(); probe(event.timeStamp); };
    range.onchange = () => rest(0);
    range.valueOf_ = value;
    row.append(name, output, range);
    by("probes").append(row);
    show();
  });
}

function probe(began) {
  const here = [...by("probes").querySelectorAll("input")].map((range) => range.valueOf_());
  by("probe").checked = true;
  const first = !state.probe;
  state.probe = here;
  if (first) state.selected = state.places.length;
  want({}, began);
}

by("probe").onchange = () => {
  if (by("probe").checked) return probe();
  state.probe = null;
  state.taps.length = Math.min(state.taps.length, state.places.length - 1);
  state.selected = Math.min(state.selected, state.places.length - 2);
  want({});
  return undefined;
};

// ---- a warm coil

// Equal steps are equal ratios of what is left to the temperature that a transient may reach: the last tenth of a kelvin
// decides, of some seventy.
const LEAST_LEFT = 1e-4;

function winding_C() {
  const [cold, hot] = state.scene.windings_C;
  return Number((hot - (hot - cold) * LEAST_LEFT ** (by("winding").value / STEPS)).toFixed(3));
}

function warmed() {
  by("warmed").hidden = !state.scene.windings_C;
  by("warm").checked = state.winding_C !== null;
  document.querySelector("#key .warm").hidden = state.winding_C === null;
  if (!state.scene.windings_C) return;
  by("winding-value").textContent = `${winding_C()} C, ${said(state.scene.windings_C[1] - winding_C(), "K")} left`;
  by("winding").setAttribute("aria-valuetext", by("winding-value").textContent);
}

function warm(began) {
  state.winding_C = by("warm").checked ? winding_C() : null;
  warmed();
  want({}, began);
}

by("warm").onchange = () => warm();
by("winding").oninput = (event) => {
  by("warm").checked = true;
  warm(event.timeStamp);
};
by("winding").onchange = () => rest(0);

// ---- the inverse question

const error = { log: true, low: 0.001, high: 1, integer: false };

function keysOfError(controls) {
  const choice = by("error-key"), before = choice.value || state.scene.input_key;
  choice.replaceChildren(...controls.filter((control) => !control.choices.length && control.value !== null)
    .map((control) => new Option(`${control.label} (${control.key})`, control.key)));
  choice.value = before;
  if (!choice.value) choice.value = state.scene.input_key;
}

function errorSaid() {
  by("error-value").textContent = `${(100 * valueAt(error, by("error").value / STEPS)).toPrecision(3)} %`;
  by("error").setAttribute("aria-valuetext", by("error-value").textContent);
}

by("error").oninput = errorSaid;
by("error").onchange = () => {
  by("answer").textContent = "searching ...";
  link.say({ type: "ask", tap: state.selected, key: by("error-key").value, tap_error: valueAt(error, by("error").value / STEPS) });
};
by("error").value = Math.round(STEPS * shareOf(error, 0.25));
errorSaid();

// ---- sound

function hear(names) {
  if (names.some((name) => sound.buffers.has(name))) return play(names);
  state.wantSound = names;
  link.say({ type: "sound", tap: state.selected });
  return undefined;
}

function sounded(message, arrays) {
  sound.take(message.rate_Hz, arrays);
  if (state.wantSound) play(state.wantSound);
  state.wantSound = null;
}

async function play(names) {
  const played = await sound.play(names);
  tell(played.length ? `playing ${played.join(", then ")}` : "no certified optimum to hear");
}

for (const button of document.querySelectorAll("[data-sound]")) button.onclick = () => hear([button.dataset.sound]);
by("compare").onclick = () => hear(["recorded", "optimum", "recorded", "optimum"]);
by("gain").oninput = () => {
  by("gain-value").textContent = `${by("gain").value} dB`;
  sound.loud(Number(by("gain").value));
};
by("gain").oninput();

// ---- own taps, saving

function dropped(files) {
  if (!files.length) return;
  const speed = by("speed").value;
  tell("reading the files ...");
  link.sendFiles([...files], { type: "drop", speed_m_s: speed ? Number(speed) : null });
}

by("files").onchange = () => {
  dropped(by("files").files);
  by("files").value = "";
};
by("reset").onclick = () => link.say({ type: "reset" });
addEventListener("dragover", (event) => {
  event.preventDefault();
  document.body.classList.add("dropping");
});
addEventListener("dragleave", () => document.body.classList.remove("dropping"));
addEventListener("drop", (event) => {
  event.preventDefault();
  document.body.classList.remove("dropping");
  dropped(event.dataTransfer.files);
});
for (const button of document.querySelectorAll("[data-save]")) {
  button.onclick = () => link.say({ type: "save", what: button.dataset.save });
}
for (const button of document.querySelectorAll("[data-figure]")) {
  button.onclick = () => detail.save(button.dataset.figure, state.scene.name);
}

// ---- the window itself

function redraw() {
  if (!state.scene || !state.times) return;
  const colour = colours();
  for (const tap of state.taps) if (tap) small(tap, colour);
  large(true);
}

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
let resizing = null;
addEventListener("resize", () => {
  clearTimeout(resizing);
  resizing = setTimeout(redraw, 100);
});
globalThis.page = state; // for whoever measures or tests it
