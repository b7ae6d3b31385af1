// What is drawn: every tap small on a canvas, which costs a fraction of a millisecond, and the selected one by plotly.

const G = 9.80665; // m/s^2
const SMALL_PX = 74;

export function colours() {
  const style = getComputedStyle(document.documentElement);
  const names = ["ground", "ink", "quiet", "grid", "recorded", "optimum", "clipped", "warm", "limit", "line"];
  return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

// The least and the greatest of every pixel's samples: what a line of so many pixels can show of a longer one.
export function decimated(x, y, pixels) {
  if (y.length <= 4 * pixels) return [x, y];
  const some = Math.ceil(y.length / pixels);
  const xs = [], ys = [];
  for (let from = 0; from < y.length; from += some) {
    let low = from, high = from;
    for (let j = from; j < Math.min(from + some, y.length); j++) {
      if (y[j] < y[low]) low = j;
      if (y[j] > y[high]) high = j;
    }
    for (const j of low < high ? [low, high] : [high, low]) {
      xs.push(x[j]);
      ys.push(y[j]);
    }
  }
  return [xs, ys];
}

function largest(values) {
  let most = 0;
  for (const value of values) if (Math.abs(value) > most) most = Math.abs(value);
  return most;
}

// One tap on its canvas: accelerations above, what drives the device below, between its limits.
export function drawSmall(canvas, times, tap, colour, windowEnd) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth || 180;
  if (canvas.width !== Math.round(width * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(SMALL_PX * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, SMALL_PX);
  const start = times[0], span = times[times.length - 1] - start;
  const at = (t) => ((t - start) / span) * width;
  const line = (values, middle, scale, ink, thickness, dashes) => {
    pen.beginPath();
    pen.strokeStyle = ink;
    pen.lineWidth = thickness;
    pen.setLineDash(dashes);
    const [xs, ys] = decimated(times, values, width);
    let drawing = false;
    for (let j = 0; j < ys.length; j++) {
      if (Number.isNaN(ys[j])) {
        drawing = false;
      } else if (drawing) {
        pen.lineTo(at(xs[j]), middle - ys[j] * scale);
      } else {
        pen.moveTo(at(xs[j]), middle - ys[j] * scale);
        drawing = true;
      }
    }
    pen.stroke();
  };
  const peak = Math.max(largest(tap.recorded_m_s2), 1e-9);
  const high = 26 / peak, low = 13 / tap.input_limit;
  pen.fillStyle = colour.grid;
  pen.fillRect(at(windowEnd), 0, 1, SMALL_PX);
  line(tap.clipped_m_s2, 29, high, colour.clipped, 1, [4, 3]);
  line(tap.recorded_m_s2, 29, high, colour.recorded, 1.2, []);
  line(tap.optimum_m_s2, 29, high, colour.optimum, 1.6, []);
  line(tap.warm_m_s2, 29, high, colour.warm, 1.2, []);
  for (const side of [-1, 1]) {
    pen.beginPath();
    pen.strokeStyle = colour.limit;
    pen.lineWidth = 1;
    pen.setLineDash([1.5, 2.5]);
    pen.moveTo(0, 59 + 13 * side);
    pen.lineTo(width, 59 + 13 * side);
    pen.stroke();
  }
  line(tap.input, 59, low, colour.optimum, 1.2, []);
  line(tap.warm_input, 59, low, colour.warm, 1, []);
}

// The selected tap, in as many panels as it has something to show in.
export class Detail {
  constructor(element, inputName, inputUnit) {
    this.element = element;
    this.input = [inputName, inputUnit];
    this.shape = "";
  }

  panels(tap) {
    return ["acceleration", "input", ...(tap.temperature_C.length ? ["temperature"] : []), "after"];
  }

  traces(times, tap) {
    const colour = colours();
    const pixels = Math.max(this.element.clientWidth, 300);
    const t = Float64Array.from(times, (s) => 1e3 * s);
    const N = tap.window;
    const inG = (values) => Float64Array.from(values, (a) => a / G);
    const curve = (name, x, y, ink, axis, line = {}) => {
      const [xs, ys] = decimated(x, y, pixels);
      return { name, x: xs, y: ys, mode: "lines", line: { color: ink, width: 1.6, ...line }, yaxis: axis,
        hovertemplate: "%{y:.3g}<extra>" + name + "</extra>", showlegend: false };
    };
    const flat = (name, value, axis) => curve(name, [t[0], t[t.length - 1]], [value, value], colour.limit, axis,
      { dash: "dot", width: 1.5 });
    const optimum = inG(tap.optimum_m_s2), clipped = inG(tap.clipped_m_s2), recorded = inG(tap.recorded_m_s2);
    const found = [
      curve("clipped", t, clipped, colour.clipped, "y", { dash: "dash", width: 1.2 }),
      curve("recorded", t, recorded, colour.recorded, "y"),
      curve("optimum", t, optimum, colour.optimum, "y", { width: 2.2 }),
      curve("clipped", t, tap.clipped_input, colour.clipped, "y2", { dash: "dash", width: 1.2 }),
      curve("optimum", t, tap.input, colour.optimum, "y2", { width: 2 }),
      flat("limit", tap.input_limit, "y2"),
      flat("limit", -tap.input_limit, "y2"),
    ];
    const warm = inG(tap.warm_m_s2);
    if (warm.length) {
      found.push(curve("on the warm coil", t, warm, colour.warm, "y", { width: 1.8 }));
      found.push(curve("on the warm coil", t, tap.warm_input, colour.warm, "y2", { width: 1.6 }));
    }
    let axis = 3;
    if (tap.temperature_C.length) {
      const winding = tap.temperature_C;
      found.push(curve("winding", t.slice(0, winding.length), winding, colour.optimum, `y${axis}`, { width: 2 }));
      axis += 1;
    }
    const error = (values) => values.slice(N).map((a, j) => a - recorded[N + j]);
    found.push(curve("clipped", t.slice(N), error(clipped), colour.clipped, `y${axis}`, { dash: "dash", width: 1.2 }));
    found.push(curve("optimum", t.slice(N), error(optimum), colour.optimum, `y${axis}`, { width: 2 }));
    if (warm.length) found.push(curve("on the warm coil", t.slice(N), error(warm), colour.warm, `y${axis}`, { width: 1.6 }));
    return found;
  }

  wide(values, least = 1e-6) {
    const most = Math.max(largest(values), least) * 1.15;
    return [-most, most];
  }

  arranged(times, tap) {
    const colour = colours();
    const panels = this.panels(tap);
    const titles = {
      acceleration: "acceleration, g",
      input: `${this.input[0]}, ${this.input[1]}`,
      temperature: `winding, C; limit ${Number((tap.temperature_limit_C || 0).toPrecision(4))}`,
      after: "error after, g",
    };
    const heights = { acceleration: 3, input: 2.6, temperature: 1.3, after: 1.3 };
    const gap = 0.035;
    const whole = panels.reduce((sum, name) => sum + heights[name], 0);
    const free = 1 - gap * (panels.length - 1);
    const layout = {
      margin: { l: 46, r: 12, t: 6, b: 38 },
      annotations: [],
      paper_bgcolor: colour.ground,
      plot_bgcolor: colour.ground,
      font: { color: colour.ink, size: 12 },
      hovermode: "x",
      dragmode: false,
      xaxis: { title: { text: "time after contact, ms" }, anchor: `y${panels.length}`, gridcolor: colour.grid,
        zeroline: false, range: [1e3 * times[0], 1e3 * times[times.length - 1]] },
      shapes: [{ type: "line", xref: "x", yref: "paper", y0: 0, y1: 1, x0: 1e3 * tap.ends, x1: 1e3 * tap.ends,
        line: { color: colour.line, width: 1, dash: "dashdot" } }],
    };
    let top = 1;
    panels.forEach((name, j) => {
      const height = (heights[name] / whole) * free;
      layout.annotations.push({ text: titles[name], xref: "paper", yref: "paper", x: 1, xanchor: "right",
        y: name === "input" ? top - 0.57 * height : top, yanchor: "top", showarrow: false, bgcolor: colour.ground,
        font: { size: 12 }, xshift: -4 });
      const axis = { anchor: "x", gridcolor: colour.grid, zerolinecolor: colour.grid, domain: [Math.max(top - height, 0), top], nticks: heights[name] > 2 ? 6 : 3 };
      if (name === "acceleration") axis.range = this.wide([largest(tap.recorded_m_s2) / G]);
      if (name === "input") axis.range = this.wide([1.15 * tap.input_limit]);
      layout[j ? `yaxis${j + 1}` : "yaxis"] = axis;
      top -= height + gap;
    });
    return layout;
  }

  // At rest plotly draws it. While something is dragged the axes stay, and the curves alone are drawn, on a canvas above
  // plotly's: that takes a millisecond, and plotly twenty.
  draw(times, tap, anew) {
    const shape = `${this.panels(tap)}:${times.length}`;
    const traces = this.traces(times, tap);
    if (!anew && shape === this.shape && tap.input_limit < 0.98 * this.layout.yaxis2.range[1]) {
      this.live(traces);
      return;
    }
    this.shape = shape;
    this.layout = this.arranged(times, tap);
    Plotly.react(this.element, traces, this.layout, { displayModeBar: false, responsive: true });
    this.element.parentElement.classList.remove("live");
  }

  live(traces) {
    const canvas = this.element.parentElement.querySelector("canvas");
    const ratio = window.devicePixelRatio || 1, full = this.element._fullLayout;
    const width = this.element.clientWidth, height = this.element.clientHeight;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const dashes = { dash: [9, 9], dot: [3, 3] };
    for (const trace of traces) {
      const across = full.xaxis, up = full[trace.yaxis.replace("y", "yaxis")];
      pen.save();
      pen.beginPath();
      pen.rect(across._offset, up._offset, across._length, up._length);
      pen.clip();
      pen.beginPath();
      pen.strokeStyle = trace.line.color;
      pen.lineWidth = trace.line.width;
      pen.setLineDash(dashes[trace.line.dash] || []);
      let drawing = false;
      for (let j = 0; j < trace.y.length; j++) {
        if (Number.isNaN(trace.y[j])) {
          drawing = false;
          continue;
        }
        const x = across._offset + across.l2p(trace.x[j]), y = up._offset + up.l2p(trace.y[j]);
        if (drawing) pen.lineTo(x, y);
        else pen.moveTo(x, y);
        drawing = true;
      }
      pen.stroke();
      pen.restore();
    }
    this.element.parentElement.classList.add("live");
  }

  // Where the limit's line lies in the element, and back from there to its value.
  get line() {
    const full = this.element._fullLayout;
    return full && full.yaxis2 ? { axis: full.yaxis2, left: full._size.l, width: full._size.w } : null;
  }

  save(kind, name) {
    const width = 1200, height = 800;
    return Plotly.downloadImage(this.element, { format: kind, filename: name, width, height, scale: kind === "png" ? 2 : 1 });
  }
}
