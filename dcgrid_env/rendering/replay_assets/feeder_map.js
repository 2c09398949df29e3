"use strict";
// The feeder under one controller: voltages on its buses, what its devices and its equipment do.

const MARGIN_PX = 26;
const STRETCH = 1.6; // how much taller than wide a diagram may be drawn to fill its place
const HALO_S = 30; // backlog, in s at the rating, at which a halo is largest
const HALO_PX = 29;
const CLOCK_PX = 10;
const STORED_PX = 14.5;
const STORED = "#7b3294";
const TRACK = "#d0d0d0";
const SYMBOLS = { inverter: "diamond-open" };

const spanOf = (values) => [Math.min(...values), Math.max(...values)];

// Height at which a map of this width is neither squeezed nor empty.
function fittingHeight(data, width) {
  const [left, right] = spanOf(data.map.buses.x), [low, high] = spanOf(data.map.buses.y);
  return ((width - 2 * MARGIN_PX) * STRETCH * (high - low)) / Math.max(right - left, 1e-9) + 2 * MARGIN_PX;
}

class FeederMap {
  constructor(holder, data, run, select) {
    Object.assign(this, { holder, data, run, select, step: 0, bus: 0, labels: "" });
    const { buses, agents } = data.map, many = buses.id.length > 60;
    this.size = data.threePhase ? (many ? 6 : 8) : many ? 8 : 12;
    const all = agents.map((_, i) => i);
    this.sites = all.filter((i) => agents[i].site);
    this.stores = all.filter((i) => run.agents[i].stored_pct);
    this.others = all.filter((i) => !agents[i].site && !agents[i].equipment && !run.agents[i].stored_pct);
    this.colour = colourScale(data);
    this.draw();
    new ResizeObserver(() => this.draw()).observe(holder);
  }

  axes() {
    const { x, y } = this.data.map.buses, width = this.holder.clientWidth, height = this.holder.clientHeight;
    const [left, right] = spanOf(x), [low, high] = spanOf(y);
    const across = (right - left) / (width - 2 * MARGIN_PX), up = (high - low) / (height - 2 * MARGIN_PX);
    const unit = Math.max(across, up, 1e-9), thinnest = unit / STRETCH;
    const axis = (low, high, unit, px) => ({
      range: [(low + high - px * unit) / 2, (low + high + px * unit) / 2], visible: false,
    });
    return {
      width, height, xaxis: axis(left, right, Math.max(across, thinnest), width),
      yaxis: axis(low, high, Math.max(up, thinnest), height),
    };
  }

  branches() {
    const { x, y, width } = this.data.map.buses;
    return [0, 1, 2].map((kind) => {
      const xs = [], ys = [];
      this.data.map.parent.forEach((parent, k) => {
        if (width[k] !== kind) return;
        xs.push(x[parent], x[k + 1], null);
        ys.push(y[parent], y[k + 1], null);
      });
      (kind ? [] : this.data.map.loops).forEach(([sending, receiving]) => {
        xs.push(x[sending], x[receiving], null);
        ys.push(y[sending], y[receiving], null);
      });
      return { x: xs, y: ys, mode: "lines", line: { color: "#9a9a9a", width: 0.9 + 1.1 * kind }, hoverinfo: "skip" };
    });
  }

  points(buses, marker) {
    const { x, y } = this.data.map.buses;
    return { x: buses.map((b) => x[b]), y: buses.map((b) => y[b]), mode: "markers", marker, hoverinfo: "skip" };
  }

  // What the library draws and places, zooms and finds under the pointer: branches, signs, and a point for each mark.
  traces() {
    const { agents, buses } = this.data.map;
    return [
      ...this.branches(),
      this.points(this.others.map((i) => agents[i].bus), {
        symbol: this.others.map((i) => SYMBOLS[agents[i].kind] || "hexagon-open"), size: 20, color: "#4d4d4d", line: { width: 1.6 },
      }),
      this.points([0], { symbol: "square-open", size: this.size + 11, color: "#333", line: { width: 1.6 } }),
      this.points(this.marks().map((mark) => mark.bus), { size: 1, opacity: 1 }),
      { ...this.points(buses.id.map((_, bus) => bus), { size: 1, opacity: 1 }), hoverinfo: "none" },
    ];
  }

  // What moves, by points of the last trace but one: a path in pixels around its bus, and its look; as many each step.
  marks() {
    const { data, run } = this, { agents, nodes } = data.map, k = stepOf(run, this.step), off = away(run, k);
    const line = (bus, d, stroke, width, opacity = 1) => ({ bus, d, fill: "none", stroke, width, opacity });
    const halo = (i) => {
      const waits_s = Math.min(HALO_S, Math.max(0, run.agents[i].backlog_kws[k] / agents[i].p_rated_kw));
      const d = arcPath(HALO_PX * Math.sqrt(waits_s / HALO_S), 1);
      return { bus: agents[i].bus, d, fill: agents[i].colour, stroke: "none", width: 0, opacity: 0.28 };
    };
    const gauge = (i, r, share, colour) => [
      line(agents[i].bus, arcPath(r, 1), TRACK, 3.2), line(agents[i].bus, arcPath(r, share), colour, 3.6),
    ];
    const node = (bus, at) => {
      const v = run.v[at][k], side = beyond(data, v), reach = data.threePhase ? 0.6 * this.size : 0;
      const turn = data.threePhase ? (2 * Math.PI * nodes.phase[at]) / 3 : 0; // a on top, b lower right, c lower left
      const d = markPath(this.size / 2, side, reach * Math.sin(turn), -reach * Math.cos(turn));
      return { bus, d, fill: this.colour(v), stroke: "#222", width: side ? 2 : 0.7, opacity: 1 };
    };
    return [
      ...this.sites.map(halo),
      ...this.sites.flatMap((i) => gauge(i, CLOCK_PX, run.agents[i].f_mhz[k] / agents[i].f_max_mhz, agents[i].colour)),
      ...this.stores.flatMap((i) => gauge(i, STORED_PX, run.agents[i].stored_pct[k] / 100, STORED)),
      ...nodes.bus.map(node),
      ...agents.flatMap((agent, i) => agent.equipment ? [] : [line(agent.bus, "M-9,-9L9,9M-9,9L9,-9", "#000", 4, off.includes(i) ? 1 : 0)]),
    ];
  }

  // Gives the library's points their looks; it would work everything out anew to change those of a few.
  paint() {
    const buses = this.data.map.buses.id.length, marks = this.marks();
    const drawn = [...this.holder.querySelectorAll("path.point")].slice(-marks.length - buses);
    const looks = [...marks, ...Array.from({ length: buses }, (_, bus) => (
      { d: arcPath(19, 1), fill: "transparent", stroke: bus === this.bus ? "#111" : "none", width: 1.8, opacity: 1 }
    ))];
    looks.forEach(({ d, fill, stroke, width, opacity }, i) => {
      const look = `fill:${fill};fill-opacity:1;stroke:${stroke};stroke-width:${width}px;opacity:${opacity}`;
      if (drawn[i].getAttribute("d") !== d) drawn[i].setAttribute("d", d);
      if (drawn[i].getAttribute("style") !== look) drawn[i].setAttribute("style", look);
    });
  }

  texts() {
    const { data, run } = this, { x, y } = data.map.buses, k = stepOf(run, this.step), off = away(run, k);
    const label = (one, text, more) => ({ x: x[one.bus], y: y[one.bus], text: text.replaceAll("<", "&lt;"), ...more });
    const names = data.map.agents.flatMap((agent, i) => agent.equipment ? [] : [
      label(agent, agent.name + (off.includes(i) ? " off" : ""), {
        showarrow: false, xshift: agent.at[0], yshift: agent.at[1], font: { size: agent.site ? 13 : 11, color: agent.colour },
      }),
    ]);
    const chip = (one, text) => label(one, text, {
      ax: one.at[0], ay: -one.at[1], arrowhead: 0, arrowwidth: 0.8, arrowcolor: "#777", bordercolor: "#777", borderpad: 1,
      font: { size: 10, color: "#333" }, bgcolor: "rgba(255,255,255,0.9)",
    });
    return [
      ...names, ...data.map.banks.map((bank) => chip(bank, bankText(bank, run, k))),
      ...data.map.capacitors.map((one) => chip(one, capacitorText(one, run, k))),
    ];
  }

  draw() {
    if (!this.holder.clientWidth) return;
    const layout = {
      ...this.axes(), margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: false, hovermode: "closest", hoverdistance: 24,
      dragmode: window.matchMedia("(pointer: coarse)").matches ? false : "pan", paper_bgcolor: "#fff",
      plot_bgcolor: "#fff", annotations: this.texts(),
    };
    const config = {
      displaylogo: false, doubleClick: "reset", displayModeBar: this.holder.clientWidth > 500 ? "hover" : false,
      modeBarButtons: [["zoomIn2d", "zoomOut2d", "resetScale2d", "toImage"]],
    };
    Plotly.react(this.holder, this.traces(), layout, config);
    if (!this.listens) this.listen();
  }

  listen() {
    this.listens = true;
    this.holder.on("plotly_afterplot", () => this.paint());
    this.paint();
    this.holder.on("plotly_click", (event) => this.select(event.points[0].pointNumber));
    this.holder.on("plotly_hover", (event) => this.describe(event.event, event.points[0].pointNumber));
    this.holder.on("plotly_unhover", hideTip);
  }

  describe(pointer, bus) {
    const words = [`bus ${this.data.map.buses.id[bus]}`, ...busWords(this.data, this.run, bus, this.step)];
    showTip(words.join("\n"), pointer.clientX + 14, pointer.clientY + 14);
  }

  show(step, bus) {
    Object.assign(this, { step, bus });
    if (!this.listens) return;
    const annotations = this.texts(), labels = annotations.map((one) => one.text).join();
    if (labels !== this.labels) Plotly.relayout(this.holder, { annotations });
    this.labels = labels;
    this.paint();
  }
}

// A node's mark around a place in pixels: a circle, or where it is outside the band a triangle that points up or down.
function markPath(r, side, x, y) {
  const n = side ? 3 : 14, reach = side ? 1.45 * r : r;
  const corners = Array.from({ length: n }, (_, i) => (2 * Math.PI * i) / n + (side < 0 ? Math.PI : 0));
  return "M" + corners.map((turn) => `${(x + reach * Math.sin(turn)).toFixed(1)},${(y - reach * Math.cos(turn)).toFixed(1)}`).join("L") + "Z";
}

// An arc from twelve o'clock, clockwise, as a path in pixels.
function arcPath(r, share) {
  const part = Math.min(1, Math.max(0, share)), n = Math.max(1, Math.ceil(36 * part));
  const corners = Array.from({ length: n + 1 }, (_, i) => (2 * Math.PI * part * i) / n);
  return "M" + corners.map((turn) => `${(r * Math.sin(turn)).toFixed(2)},${(-r * Math.cos(turn)).toFixed(2)}`).join("L");
}

// From a voltage to its colour, mixed between the scale's own.
function colourScale(data) {
  const [low, high] = data.range_pu, rgb = data.colours.map((c) => [1, 3, 5].map((i) => parseInt(c.slice(i, i + 2), 16)));
  return (v) => {
    if (!Number.isFinite(v)) return "#bdbdbd";
    const place = Math.min(1, Math.max(0, (v - low) / (high - low))) * (rgb.length - 1);
    const i = Math.min(rgb.length - 2, Math.floor(place)), part = place - i;
    return `rgb(${rgb[i].map((own, c) => Math.round(own + part * (rgb[i + 1][c] - own))).join(",")})`;
  };
}
