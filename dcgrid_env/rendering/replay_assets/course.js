"use strict";
// What the page holds, unpacked: the data, and the figures of a bus in words.

async function unzipped(id) {
  try {
    const bytes = Uint8Array.from(atob(document.getElementById(id).textContent.trim()), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return await new Response(stream).text();
  } catch {
    throw new Error("the data in this file are damaged");
  }
}

function unpacked(packed) {
  const values = new Float64Array(packed.d.length);
  const unit = 10 ** packed.k;
  let sum = 0;
  packed.d.forEach((difference, i) => {
    if (difference === null) values[i] = NaN;
    else values[i] = (sum += difference) / unit;
  });
  return values;
}

const sumOf = (curves) => curves[0].map((_, k) => curves.reduce((sum, one) => sum + one[k], 0));

function unpackAll(data) {
  for (const run of data.runs) {
    run.j = unpacked(run.j);
    run.v = run.v.map(unpacked);
    run.agents = run.agents.map((own) =>
      Object.fromEntries(Object.entries(own).map(([name, values]) => [name, unpacked(values)])));
    for (const name of ["tap", "on", "relay", "timer"]) run[name] = (run[name] || []).map((values) => values && unpacked(values));
    const sites = run.agents.filter((_, i) => data.map.agents[i].site);
    for (const name of ["p_kw", "p_ref_kw"]) run[name] = sites.length ? sumOf(sites.map((own) => own[name])) : null;
    run.unbalance_pct = run.unbalance_pct ? unpacked(run.unbalance_pct) : null;
  }
  data.last = Math.max(...data.runs.map((run) => run.steps)) - 1;
  data.nodesOf = data.map.buses.id.map(() => []);
  data.map.nodes.bus.forEach((bus, node) => data.nodesOf[bus].push(node));
  data.agentsAt = (bus) => data.map.agents.map((_, i) => i).filter((i) => data.map.agents[i].bus === bus);
  data.threePhase = data.map.nodes.phase !== null;
  return data;
}

// Where a run stands at a step of the page: an episode that has ended early stays as it ended.
const stepOf = (run, step) => Math.min(step, run.steps - 1);
const figure = (value, decimals) =>
  Number.isFinite(value)
    ? value.toLocaleString("en-US", { minimumFractionDigits: decimals, maximumFractionDigits: decimals })
    : "none";
const signed = (tap) => (tap > 0 ? "+" : tap < 0 ? "\u2212" : "") + Math.abs(tap);

// 1 above the band, -1 below it, 0 within; a voltage held exactly at the limit is within.
function beyond(data, v) {
  return v > 1 + data.band_pu + 1e-6 ? 1 : v < 1 - data.band_pu - 1e-6 ? -1 : 0;
}

function voltageWords(data, run, bus, step) {
  const parts = data.nodesOf[bus].map((node) => {
    const v = run.v[node][stepOf(run, step)];
    const phase = data.threePhase ? "abc"[data.map.nodes.phase[node]] + " " : "";
    return phase + { 1: "\u25b2\u00a0", 0: "", "-1": "\u25bc\u00a0" }[beyond(data, v)] + figure(v, 4);
  });
  return `voltage ${parts.join(", ")}\u00a0p.u.`; // no line breaks between a figure and its unit
}

// One line a device at a bus, with its figures in units.
function busWords(data, run, bus, step) {
  const k = stepOf(run, step);
  const lines = [voltageWords(data, run, bus, step)];
  for (const i of data.agentsAt(bus)) {
    const parts = Object.entries(run.agents[i]).map(([name, values]) => {
      const [label, unit, decimals] = data.shown[name];
      return `${label} ${figure(values[k], decimals)}\u00a0${unit.replace(" ", "\u00a0")}`;
    });
    lines.push(`${data.map.agents[i].id}: ${parts.join(", ")}`);
  }
  for (const bank of data.map.banks.filter((one) => one.bus === bus)) lines.push(bankText(bank, run, k));
  for (const one of data.map.capacitors.filter((c) => c.bus === bus)) lines.push(capacitorText(one, run, k));
  return lines;
}

const bankText = (bank, run, k) =>
  `${bank.name} ${bank.rows.map((row, i) => bank.phases[i] + signed(run.tap[row][k])).join(" ")}`;
const capacitorText = (one, run, k) => `${one.name} ${{ 1: "on", 0: "off" }[run.on[one.row][k]] || "lost"}`;
const away = (run, k) =>
  run.agents.map((own, i) => i).filter((i) => run.agents[i].on_grid_pct && run.agents[i].on_grid_pct[k] < 99.5);
