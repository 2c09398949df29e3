"use strict";
// Curves of the feeder and of the selected bus over the episode, all controllers on the same axes.

const RUN_COLOURS = ["#0072b2", "#d55e00", "#009e73", "#000000"];
const RUN_DASHES = ["solid", "dash", "dot", "dashdot"];
const STEPS_HELD = ["p_kw", "p_ref_kw", "q_kvar", "f_mhz", "on_grid_pct"]; // over the interval that ends at a step
const ROW_PX = 168;

class Curves {
  constructor(holder, names, data, seek) {
    Object.assign(this, { holder, names, data, seek, bus: 0, step: 0 });
    new ResizeObserver(() => this.draw()).observe(holder);
  }

  // What is drawn for the selected bus: a name with its unit, and its curves by run.
  panels() {
    const { data, bus } = this, list = [{ name: "cost so far, J", decimals: 3, of: (run) => [run.j] }];
    if (data.runs[0].p_kw) {
      list.push({ name: "all data centres (kW), pale: demand", decimals: 1, held: true, of: (run) => [run.p_kw], asked: data.runs[0].p_ref_kw });
    }
    for (const node of data.nodesOf[bus]) {
      const phase = data.threePhase ? ` ${"abc"[data.map.nodes.phase[node]]}` : "";
      list.push({ name: `voltage${phase} (p.u.)`, decimals: 4, of: (run) => [run.v[node]], edges: [1 - data.band_pu, 1 + data.band_pu], ticks: ".2f" });
    }
    for (const i of data.agentsAt(bus)) {
      const there = data.runs[0].agents[i];
      for (const name of Object.keys(there)) {
        if (name === "p_ref_kw" || (name === "q_kvar" && data.runs.every((run) => run.agents[i].q_kvar.every((q) => q === 0)))) continue;
        const [label, unit, decimals] = data.shown[name];
        const asked = name === "p_kw" && there.p_ref_kw;
        list.push({
          name: `${data.map.agents[i].id}: ${label} (${unit})` + (asked ? ", pale: demand" : ""), decimals,
          held: STEPS_HELD.includes(name), of: (run) => [run.agents[i][name]], asked: asked || null,
        });
      }
    }
    for (const bank of data.map.banks.filter((one) => one.bus === bus)) {
      bank.rows.forEach((row, i) => list.push({
        name: `${bank.name}: tap ${bank.phases[i]}`, decimals: 0, taps: true, of: (run) => [run.tap[row]],
      }));
      bank.rows.filter((row) => data.runs.every((run) => run.relay[row])).forEach((row) => {
        const phase = bank.phases[bank.rows.indexOf(row)];
        list.push({ name: `${bank.name}: relay deviation ${phase} (half bands)`, decimals: 2, edges: [-1, 1], of: (run) => [run.relay[row]] });
        list.push({ name: `${bank.name}: timer ${phase} (s)`, decimals: 0, of: (run) => [run.timer[row]] });
      });
    }
    if (data.threePhase) list.push({ name: "largest V2 / V1 (%)", decimals: 2, of: (run) => [run.unbalance_pct] });
    return list;
  }

  draw() {
    const width = this.holder.clientWidth;
    if (!width || !this.data) return;
    const { data } = this, panels = this.panels();
    const columns = Math.min(panels.length, width >= 1000 ? 4 : width >= 720 ? 3 : width >= 480 ? 2 : 1);
    const rows = Math.ceil(panels.length / columns), height = rows * ROW_PX;
    const t = Array.from({ length: data.last + 1 }, (_, k) => k * data.time[0]);
    const layout = {
      width, height, margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: false, hovermode: "x", dragmode: false,
      shapes: [], paper_bgcolor: "#fff", plot_bgcolor: "#fff", font: { size: 11 },
    };
    const traces = [];
    this.names.replaceChildren();
    panels.forEach((panel, i) => {
      const id = i ? i + 1 : "", column = i % columns, row = Math.floor(i / columns);
      const left = (column * width) / columns + 48, right = ((column + 1) * width) / columns - 12;
      const top = row * ROW_PX + 24, bottom = (row + 1) * ROW_PX - 26;
      const axis = { gridcolor: "#e6e6e6", zeroline: false, fixedrange: true, nticks: 4, linecolor: "#888", automargin: false };
      layout[`xaxis${id}`] = { ...axis, nticks: 6, domain: [left / width, right / width], anchor: `y${id}`, range: [0, data.last * data.time[0]] };
      layout[`yaxis${id}`] = { ...axis, domain: [1 - bottom / height, 1 - top / height], anchor: `x${id}`, rangemode: panel.held ? "tozero" : "normal" };
      if (panel.ticks) layout[`yaxis${id}`].tickformat = panel.ticks;
      if (row === rows - 1 || i + columns >= panels.length) layout[`xaxis${id}`].ticksuffix = ` ${data.time[1]}`;
      withTerms(element(this.names, "span", "", { style: `left:${left - 40}px;top:${top - 22}px` }), panel.name, data.terms);
      layout.shapes.push({ type: "line", xref: `x${id}`, yref: `y${id} domain`, y0: 0, y1: 1, line: { color: "#111", width: 1.2 } });
      traces.push(...this.lines(panel, t, { xaxis: `x${id}`, yaxis: `y${id}` }));
    });
    this.cursors = layout.shapes;
    this.place();
    this.layout = layout;
    this.holder.style.height = `${height}px`;
    Plotly.react(this.holder, traces, layout, { displayModeBar: false });
    if (this.listens) return;
    this.listens = true;
    this.holder.on("plotly_click", (event) => this.seek(Math.round(event.points[0].x / data.time[0])));
  }

  lines(panel, t, axes) {
    const { data } = this, list = [];
    const flat = (y) => ({
      x: [0, t[t.length - 1]], y: [y, y], ...axes, mode: "lines", hoverinfo: "skip", line: { color: "#444", width: 1, dash: "dash" },
    });
    for (const edge of panel.edges || []) list.push(flat(edge));
    if (panel.asked) {
      list.push({ x: t, y: panel.asked, ...axes, mode: "lines", hoverinfo: "skip", line: { color: "#c9c9c9", width: 4, shape: "vh" } });
    }
    data.runs.forEach((run, r) => {
      for (const y of panel.of(run)) {
        list.push({
          x: t, y, ...axes, mode: "lines", name: run.name.replaceAll("<", "&lt;"),
          hovertemplate: `%{y:.${panel.decimals}f}`, line: {
            color: RUN_COLOURS[r], dash: RUN_DASHES[r], width: 1.8, shape: panel.taps ? "hv" : panel.held ? "vh" : "linear",
          },
        });
      }
    });
    return list;
  }

  place() {
    for (const cursor of this.cursors) cursor.x0 = cursor.x1 = this.step * this.data.time[0];
  }

  select(bus) {
    this.bus = bus;
    this.draw();
  }

  show(step) {
    this.step = step;
    if (!this.layout) return;
    this.place();
    Plotly.relayout(this.holder, { shapes: this.cursors.map((one) => ({ ...one })) });
  }
}
