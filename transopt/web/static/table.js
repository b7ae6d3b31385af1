// What each tap comes to, in numbers and words.

import { differs, explain, made, write } from "./words.js";

const PRICE = { width: 96, height: 26, edge: 3 };

// Words of what binds without when: "current +4 A at 1 to 2 ms; supply ..." is "current, supply".
function brief(binding) {
  return [...new Set(binding.split("; ").map((each) => each.replace(/ [-+]?[0-9.e]+ .*/, "")))].join(", ");
}

// A small curve of the tap error over the limit that is dearest, its present place marked.
function priceCurve(svg, prices) {
  const price = prices.find((each) => each.points.length > 1);
  if (!price) return "";
  const xs = price.points.map(([bound]) => bound), ys = price.points.map(([, error]) => error);
  const [x0, x1, y1] = [Math.min(...xs), Math.max(...xs), Math.max(...ys)], y0 = Math.min(...ys);
  const x = (value) => PRICE.edge + ((value - x0) / (x1 - x0 || 1)) * (PRICE.width - 2 * PRICE.edge);
  const y = (value) => PRICE.height - PRICE.edge - ((value - y0) / (y1 - y0 || 1)) * (PRICE.height - 2 * PRICE.edge);
  const now = price.points.find(([bound]) => bound === price.now) ?? price.points[0];
  svg.innerHTML = `<path class="optimum" d="M${price.points.map(([a, b]) => `${x(a)} ${y(b)}`).join("L")}"/>`
    + price.points.map(([a, b]) => `<circle class="solved" cx="${x(a)}" cy="${y(b)}" r="1.4"/>`).join("")
    + `<circle class="now" cx="${x(now[0])}" cy="${y(now[1])}" r="3.2"/>`;
  return `${price.label} from ${Number(x0.toPrecision(3))} to ${Number(x1.toPrecision(3))} ${price.unit}: tap error from `
    + `${(100 * ys[0]).toFixed(1)} to ${(100 * ys[ys.length - 1]).toFixed(1)} %, every point solved. ${price.sentence}`;
}

export class Table {
  constructor(element, selects) {
    Object.assign(this, { element, selects });
    const around = element.parentElement;
    new IntersectionObserver((seen) => around.classList.toggle("unseen", !seen.at(-1).isIntersecting)).observe(around);
  }

  open(scene, places) {
    const warm = scene.windings_C ? [["warm", "warm %", "tap error of what is played on the warm coil"]] : [];
    this.columns = [...scene.columns.map(({ name, head, meaning }) => [name, head, meaning]), ...warm,
      ["binding", "binds", "the limits that hold this tap back; the selected tap has the times below its plot"],
      ["price", "price", "tap error over the limit that is dearest: left half of it, right where it stops mattering; the dot is now. Known at rest."],
      ["state", "state", "certified: proven to be the best under these limits. Replayed: simulated in continuous time and admitted, as a library would hold it."]];
    const row = made("tr");
    for (const [name, head, meaning] of [...scene.heads.map((each) => [each, each, ""]), ...this.columns]) {
      row.append(made("th", { scope: "col", className: name },
        meaning ? made("button", { type: "button", className: "term", textContent: head, dataset: { tip: meaning } }) : head));
    }
    this.element.tHead.replaceChildren(row);
    this.rows = places.map((place, index) => {
      const names = place.target ? [place.target] : [place.speed_m_s, place.grip_N].map((v) => String(Number(v.toPrecision(4))));
      const line = made("tr", {}, ...names.map((name, j) => made("th", { scope: "row", textContent: name, dataset: { head: scene.heads[j] } })),
        ...this.columns.map(([name, head]) => made("td", { className: name, dataset: { head } })));
      line.onclick = () => this.selects(index);
      return line;
    });
    this.element.tBodies[0].replaceChildren(...this.rows);
  }

  select(index) {
    this.rows.forEach((line, j) => line.setAttribute("aria-selected", String(j === index)));
  }

  show(tap, number) {
    const line = this.rows[tap.index];
    if (!line) return;
    line.classList.toggle("refused", !tap.certified);
    line.dataset.frame = number;
    this.columns.forEach(([name], j) => {
      const cell = line.cells[line.cells.length - this.columns.length + j];
      if (name === "price") this.price(cell, tap);
      else if (name === "binding") this.words(cell, brief(tap.cells.binding), tap.cells.binding);
      else if (name === "warm") this.words(cell, tap.warm?.figures && tap.warm.scale ? (100 * tap.warm.figures.tap_error).toFixed(1) : "-", tap.warm?.words ?? "");
      else if (name === "state") this.words(cell, tap.certified ? (tap.replayed ? "replayed" : "certified") : "refused", tap.verdict || tap.reason);
      else write(cell, tap.cells[name]);
    });
  }

  words(cell, text, tip) {
    write(cell, text);
    explain(cell, tip === text ? "" : tip);
  }

  price(cell, tap) {
    const known = tap.replayed || !tap.certified;
    if (!known || !tap.prices.some((each) => each.points.length > 1)) {
      explain(cell, tap.prices[0]?.sentence ?? "");
      write(cell, known ? "-" : "...");
      return;
    }
    if (!differs(cell, "text", tap.prices)) return;
    cell.innerHTML = `<svg role="img" viewBox="0 0 ${PRICE.width} ${PRICE.height}" width="${PRICE.width}" height="${PRICE.height}"></svg>`;
    const words = priceCurve(cell.firstElementChild, tap.prices);
    cell.firstElementChild.setAttribute("aria-label", words);
    explain(cell, words);
  }
}
