// Numbers and their words.

export function quantity(value, unit) {
  if (value === null || value === undefined) return "not stated";
  const text = typeof value === "number" ? String(Number(value.toPrecision(4))) : value;
  return unit ? `${text} ${unit}` : text;
}

// As the terminal and the report write it.
export function percent(share) {
  if (share === null || share === undefined) return "-";
  return (100 * share).toFixed(share < 0.09995 ? 2 : 1);
}

export function shareOf(scale, value) {
  if (scale.share) return scale.share(value);
  if (scale.log) return Math.log(value / scale.low) / Math.log(scale.high / scale.low);
  return (value - scale.low) / (scale.high - scale.low || 1);
}

export function valueAt(scale, share) {
  if (scale.at) return scale.at(share);
  const value = scale.log ? scale.low * (scale.high / scale.low) ** share : scale.low + share * (scale.high - scale.low);
  const rounded = scale.integer ? Math.round(value) : Number(value.toPrecision(3));
  return Math.min(Math.max(rounded, scale.low), scale.high);
}

export function largest(values) {
  let most = 0;
  for (const value of values) if (Math.abs(value) > most) most = Math.abs(value);
  return most;
}

export function made(kind, properties = {}, ...children) {
  const { dataset, attributes, ...own } = properties;
  const element = Object.assign(document.createElement(kind), own);
  Object.assign(element.dataset, dataset);
  for (const [name, value] of Object.entries(attributes ?? {})) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

// What was written to an element last, by name. Comparing with it is quicker than reading the page, and an element that
// is written again without need is laid out and painted again.
const written = new WeakMap();

export function differs(element, name, value) {
  if (!written.has(element)) written.set(element, new Map());
  const values = written.get(element);
  if (values.get(name) === value) return false;
  values.set(name, value);
  return true;
}

export function write(element, text) {
  if (!differs(element, "text", text)) return;
  const { firstChild: only } = element;
  if (only instanceof Text && !only.nextSibling) only.data = text; // a new node would take another layout object
  else element.textContent = text;
}

export function label(element, words) {
  if (differs(element, "label", words)) element.setAttribute("aria-label", words);
}

export function explain(element, tip) {
  if (differs(element, "tip", tip)) element.dataset.tip = tip;
}

export const by = (id) => document.getElementById(id);
