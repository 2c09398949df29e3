"use strict";
// The feeder under one controller: voltages on its buses, what its devices and its equipment do.

const MARGIN_PX = 34;
const HALO_S = 30; // backlog, in s at the rating, at which a halo is largest
const HALO_PX = 58;
const CLOCK_PX = 10;
const STORED_PX = 14;
const STORED = "#7b3294";
const SYMBOLS = { inverter: "diamond-open", storage: "square-open" };
const TURNS = [0, 120, 240]; // where the mark of a phase stands: a on top, b lower right, c lower left

class FeederMap {
  constructor(holder, data, run, select) {
    Object.assign(this, { holder, data, run, select });
    const { buses, agents } = data.map;
    const many = buses.id.length > 60;
    this.size = data.threePhase ? (many ? 6 : 8) : many ? 8 : 11;
    this.step = 0;
    this.bus = 0;
    this.sites = agents.map((_, i) => i).filter((i) => agents[i].site);
    this.stores = agents.map((_, i) => i).filter((i) => run.agents[i].stored_pct);
    this.phases = data.threePhase ? [0, 1, 2] : [null];
    this.nodes = this.phases.map((phase) =>
      data.map.nodes.bus.map((_, node) => node).filter((node) => !data.threePhase || data.map.nodes.phase[node] === phase));
    this.labels = "";
    this.draw();
    new ResizeObserver(() => this.draw()).observe(holder);
  }

  // Pixels to the map's units, the same along both axes.
  frame() {
    const { x, y } = this.data.map.buses;
    const width = this.holder.clientWidth, height = this.holder.clientHeight;
    const [left, right, low, high] = [Math.min(...x), Math.max(...x), Math.min(...y), Math.max(...y)];
    const unit = Math.max((right - left) / (width - 2 * MARGIN_PX), (high - low) / (height - 2 * MARGIN_PX), 1e-9);
    const [cx, cy] = [(left + right) / 2, (low + high) / 2];
    this.unit = unit;
    const axis = (middle, px) => ({ range: [middle - (px * unit) / 2, middle + (px * unit) / 2], visible: false });
    return {
      width, height, margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: false, hovermode: "closest", hoverdistance: 14,
      dragmode: window.matchMedia("(pointer: coarse)").matches ? false : "pan", xaxis: axis(cx, width),
      yaxis: axis(cy, height), paper_bgcolor: "#fff", plot_bgcolor: "#fff", annotations: this.texts(),
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
      return { x: xs, y: ys, mode: "lines", line: { color: "#9a9a9a", width: 0.9 + 1.1 * kind }, hoverinfo: "skip" };
    });
  }

  arc(bus, radius_px, share) {
    const { x, y } = this.data.map.buses;
    const xs = [], ys = [], r = radius_px * this.unit, n = Math.max(2, Math.ceil(40 * share));
    for (let i = 0; i <= n; i++) {
      const turn = (2 * Math.PI * share * i) / n;
      xs.push(x[bus] + r * Math.sin(turn));
      ys.push(y[bus] + r * Math.cos(turn));
    }
    return [xs, ys];
  }

  rings(list) {
    const xs = [], ys = [];
    for (const [bus, radius, share] of list) {
      const [ax, ay] = this.arc(bus, radius, share);
      xs.push(...ax, null);
      ys.push(...ay, null);
    }
    return { x: xs, y: ys, mode: "lines", hoverinfo: "skip" };
  }

  points(buses, marker) {
    const { x, y } = this.data.map.buses;
    return { x: buses.map((b) => x[b]), y: buses.map((b) => y[b]), mode: "markers", marker, hoverinfo: "skip" };
  }

  traces() {
    const { data, run } = this, { agents } = data.map, k = stepOf(run, this.step);
    const at = (list) => list.map((i) => agents[i].bus);
    const share = (i) => Math.min(1, Math.max(0, run.agents[i].f_mhz[k] / agents[i].f_max_mhz));
    const waits = (i) => Math.min(1, run.agents[i].backlog_kws[k] / agents[i].p_rated_kw / HALO_S);
    const marked = agents.map((_, i) => i).filter((i) => !agents[i].site && !agents[i].equipment && !run.agents[i].stored_pct);
    const list = [
      ...this.branches(),
      this.points(at(this.sites), {
        size: this.sites.map((i) => HALO_PX * Math.sqrt(Math.max(waits(i), 0))), opacity: 0.28, line: { width: 0 },
        color: this.sites.map((i) => agents[i].colour),
      }),
      this.points(at(marked), {
        symbol: marked.map((i) => SYMBOLS[agents[i].kind] || "hexagon-open"), size: 19,
        color: "#4d4d4d", line: { width: 1.6 },
      }),
      { ...this.rings([...this.sites.map((i) => [agents[i].bus, CLOCK_PX, 1]), ...this.stores.map((i) => [agents[i].bus, STORED_PX, 1])]),
        line: { color: "#d4d4d4", width: 3 } },
      ...this.sites.map((i) => ({ ...this.rings([[agents[i].bus, CLOCK_PX, share(i)]]), line: { color: agents[i].colour, width: 3.4 } })),
      { ...this.rings(this.stores.map((i) => [agents[i].bus, STORED_PX, Math.min(1, run.agents[i].stored_pct[k] / 100)])),
        line: { color: STORED, width: 3 } },
      this.points([0], { symbol: "square-open", size: this.size + 11, color: "#333", line: { width: 1.6 } }),
      ...this.voltages(k),
      this.points(at(away(run, k)), { symbol: "x-thin", size: 22, color: "#000", line: { width: 4, color: "#000" } }),
      this.points([this.bus], { symbol: "circle-open", size: 40, color: "#111", line: { width: 2 } }),
    ];
    return list;
  }

  voltages(k) {
    const { data, run } = this;
    return this.nodes.map((nodes, p) => {
      const v = nodes.map((node) => run.v[node][k]);
      const side = v.map((one) => beyond(data, one));
      const trace = this.points(nodes.map((node) => data.map.nodes.bus[node]), {
        color: v, cmin: data.range_pu[0], cmax: data.range_pu[1], showscale: false, opacity: 1,
        colorscale: data.colours.map((colour, i) => [i / (data.colours.length - 1), colour]),
        symbol: side.map((one) => (one === 0 ? "circle" : one > 0 ? "triangle-up" : "triangle-down")),
        size: side.map((one) => (one === 0 ? this.size : this.size + 3)),
        line: { color: "#222", width: side.map((one) => (one === 0 ? 0.6 : 2)) },
      });
      if (data.threePhase) Object.assign(trace.marker, { angle: TURNS[p], standoff: -0.62 * this.size });
      trace.hoverinfo = "none";
      trace.customdata = nodes.map((node) => data.map.nodes.bus[node]);
      return trace;
    });
  }

  texts() {
    const { data, run } = this, { x, y } = data.map.buses, k = stepOf(run, this.step);
    const off = away(run, k);
    const label = (one, text, more) => ({
      x: x[one.bus], y: y[one.bus], text: text.replaceAll("<", "&lt;"), bgcolor: "rgba(255,255,255,0.78)", ...more,
    });
    const names = data.map.agents.map((agent, i) => agent.equipment ? null : label(agent, agent.name + (off.includes(i) ? " off" : ""), {
      showarrow: false, xshift: agent.at[0], yshift: agent.at[1], font: { size: agent.site ? 13 : 11, color: agent.colour },
    })).filter(Boolean);
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
    this.layout = this.frame();
    const config = {
      displaylogo: false, responsive: false, doubleClick: "reset", displayModeBar: this.holder.clientWidth > 500 ? "hover" : false,
      modeBarButtons: [["zoomIn2d", "zoomOut2d", "resetScale2d", "toImage"]],
    };
    Plotly.react(this.holder, this.traces(), this.layout, config);
    if (!this.listens) this.listen();
  }

  listen() {
    this.listens = true;
    this.holder.on("plotly_click", (event) => this.select(event.points[0].customdata));
    this.holder.on("plotly_hover", (event) => showTip(event.event, this.data, this.run, event.points[0].customdata));
    this.holder.on("plotly_unhover", hideTip);
    this.holder.on("plotly_relayout", (changed) => {
      const from = changed["xaxis.range[0]"];
      if (from === undefined) return;
      this.unit = (changed["xaxis.range[1]"] - from) / this.holder.clientWidth; // rings keep their size when zoomed
      this.refresh();
    });
  }

  show(step, bus) {
    this.step = step;
    this.bus = bus;
    this.refresh();
  }

  refresh() {
    const texts = this.texts(), labels = texts.map((one) => one.text).join();
    if (labels !== this.labels) this.layout.annotations = texts;
    this.labels = labels;
    Plotly.react(this.holder, this.traces(), this.layout);
  }
}

function showTip(event, data, run, bus) {
  let tip = document.getElementById("tip");
  if (!tip) {
    tip = document.body.appendChild(document.createElement("div"));
    tip.id = "tip";
  }
  tip.hidden = false;
  tip.textContent = [`bus ${data.map.buses.id[bus]}`, ...busWords(data, run, bus, replayState.step)].join("\n");
  tip.style.left = Math.max(4, Math.min(event.clientX + 14, window.innerWidth - tip.offsetWidth - 6)) + "px";
  tip.style.top = Math.max(4, Math.min(event.clientY + 14, window.innerHeight - tip.offsetHeight - 6)) + "px";
}

function hideTip() {
  const tip = document.getElementById("tip");
  if (tip) tip.hidden = true;
}
