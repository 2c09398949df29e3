"use strict";
// The page: its controls, its keys, and what is shown at a step.

const replayState = { step: 0, bus: 0, playing: false };

function busName(data, bus) {
  const here = data.agentsAt(bus).map((i) => data.map.agents[i].id);
  const equipment = [...data.map.banks, ...data.map.capacitors].filter((one) => one.bus === bus).map((one) => one.name);
  const all = [...(bus === 0 ? ["substation"] : []), ...here, ...equipment];
  return `bus ${data.map.buses.id[bus]}` + (all.length ? ` (${all.join(", ")})` : "");
}

function runCard(data, run, r) {
  const card = element(byId("maps"), "article", "", { class: "run" });
  const heading = element(card, "h3");
  heading.innerHTML = `<svg width="34" height="8" aria-hidden="true"><line x1="0" y1="4" x2="34" y2="4" stroke="${RUN_COLOURS[r]}"
    stroke-width="3" stroke-dasharray="${["", "9 4", "3 3", "9 3 3 3"][r]}"/></svg>`;
  element(heading, "span", run.name);
  const j = element(heading, "span", "", { class: "j" });
  withTerms(j, "J ", data.terms);
  const cost = element(j, "span");
  const trips = run.agents.some((one) => one.on_grid_pct);
  const state = element(card, "p", "", { class: trips ? "state long" : "state" });
  const map = element(card, "div", "", { class: "map", role: "img", "aria-label": `map of the feeder under ${run.name}` });
  const reading = element(card, "p", "", { class: "reading" });
  return { run, cost, state, map, reading };
}

function summary(data, run, step) {
  const k = stepOf(run, step);
  let outside = 0, lowest = Infinity, where = 0;
  for (const node of data.map.judged) {
    const v = run.v[node][k];
    outside += beyond(data, v) !== 0;
    if (v < lowest) [lowest, where] = [v, node];
  }
  const phase = data.threePhase ? "." + "abc"[data.map.nodes.phase[where]] : "";
  const parts = [
    `${outside} of ${data.map.judged.length} ${data.threePhase ? "nodes" : "buses"} outside`,
    `lowest ${figure(lowest, 4)}\u00a0p.u. at\u00a0bus\u00a0${data.map.buses.id[data.map.nodes.bus[where]]}${phase}`,
  ];
  const off = away(run, k).map((i) => `${data.map.agents[i].id} ${figure(run.agents[i].on_grid_pct[k], 0)} %`);
  if (off.length) parts.push(`on the grid: ${off.join(", ")}`);
  if (!run.converged && step >= run.steps - 1) parts.push("the power flow has no solution: voltage collapse");
  return parts.join(" \u00b7 ");
}

function drawLegend(data) {
  const legend = byId("legend"), [low, high] = data.range_pu;
  const at = (v) => 10 + (220 * (v - low)) / (high - low);
  const stops = data.colours.map((c, i) => `<stop offset="${i / (data.colours.length - 1)}" stop-color="${c}"/>`).join("");
  const marks = [1 - data.band_pu, 1 + data.band_pu].map((v) =>
    `<line x1="${at(v)}" x2="${at(v)}" y1="0" y2="16" stroke="#000" stroke-width="3"/>`).join("");
  const ticks = [1 - data.band_pu, 1, 1 + data.band_pu].map((v) =>
    `<text x="${at(v)}" y="29" font-size="11" text-anchor="middle" fill="#333">${v.toFixed(3)}</text>`).join("");
  const mark = (inner) => `<svg width="20" height="20" viewBox="-10 -10 20 20" aria-hidden="true">${inner}</svg>`;
  const ring = (colour, r) => `<circle r="${r}" fill="none" stroke="#d4d4d4" stroke-width="3"/><path d="M0 ${-r} A${r} ${r} 0 0 1 0 ${r}" fill="none" stroke="${colour}" stroke-width="3"/>`;
  const kinds = new Set(data.map.agents.filter((one) => !one.equipment).map((one) => one.kind));
  const stores = data.runs[0].agents.some((one) => one.stored_pct), trips = data.runs.some((run) => run.agents.some((one) => one.on_grid_pct));
  const entries = [
    ["M-6 5 L6 5 L0 -6 Z", "violation above the band"], ["M-6 -5 L6 -5 L0 6 Z", "violation below the band"],
  ].map(([d, text]) => [mark(`<path d="${d}" fill="#ccc" stroke="#222" stroke-width="2"/>`), text]);
  entries.push([mark('<rect x="-7" y="-7" width="14" height="14" fill="none" stroke="#333" stroke-width="1.6"/>'), "substation"]);
  if (data.threePhase) entries.push([mark('<g fill="#ccc" stroke="#222"><circle cy="-4" r="3"/><circle cx="4" cy="3" r="3"/><circle cx="-4" cy="3" r="3"/></g>'), "phases: a top, b right, c left"]);
  if (data.map.agents.some((one) => one.site)) {
    entries.push([mark(ring("#0072b2", 7)), "data centre: ring shows the clock"]);
    entries.push([mark('<circle r="9" fill="#0072b2" opacity="0.28"/>'), `halo: backlog, largest at ${HALO_S} s of full load`]);
  }
  if (kinds.has("inverter")) entries.push([mark('<path d="M0 -7 L7 0 L0 7 L-7 0 Z" fill="none" stroke="#4d4d4d" stroke-width="1.6"/>'), "inverter"]);
  if (stores) entries.push([mark(ring(STORED, 8)), "outer ring: stored energy"]);
  if (trips) entries.push([mark('<path d="M-6 -6 L6 6 M6 -6 L-6 6" stroke="#000" stroke-width="3.5"/>'), "off the grid"]);
  legend.innerHTML = `<svg id="scale" viewBox="0 0 240 32" role="img" aria-label="voltage from blue, low, to red, high; black lines are the limits">
    <defs><linearGradient id="g">${stops}</linearGradient></defs><rect x="10" y="2" width="220" height="12" fill="url(#g)" stroke="#555"/>${marks}${ticks}</svg>`;
  for (const [sign, text] of [["", "voltage (p.u.)"], ...entries]) {
    const entry = element(legend, "span");
    entry.innerHTML = sign;
    withTerms(element(entry, "span"), text, data.terms);
  }
}

function fitMaps(data) {
  const n = data.runs.length, wide = window.innerWidth > 700, style = document.documentElement.style;
  style.setProperty("--columns", wide ? Math.min(n, window.innerWidth >= 1100 ? 4 : 2) : 1);
  const width = byId("maps").querySelector(".map").clientWidth;
  const most = wide ? Math.max(300, window.innerHeight - 440) : Math.min(340, window.innerHeight * 0.5);
  style.setProperty("--map-height", `${Math.round(Math.max(190, Math.min(most, fittingHeight(data, width))))}px`);
}

async function openReplay() {
  if (typeof DecompressionStream === "undefined") throw new Error("this browser is older than 2023");
  const library = document.createElement("script");
  library.textContent = await unzipped("plotly");
  document.head.appendChild(library);
  const data = unpackAll(JSON.parse(await unzipped("data")));
  byId("title").textContent = data.title;
  const cards = data.runs.map((run, r) => runCard(data, run, r));
  fitMaps(data);
  drawLegend(data);
  const firstSite = data.map.agents.find((one) => one.bus !== undefined);
  replayState.bus = firstSite ? firstSite.bus : 0;
  const time = byId("time"), speed = byId("speed"), chooser = byId("bus");
  time.max = data.last;
  data.map.buses.id.forEach((_, bus) => element(chooser, "option", busName(data, bus), { value: bus }));
  const rates = [1, 2, 5, 10, 20, 50];
  const usual = rates.find((rate) => data.last / rate <= 30) || 50;
  for (const rate of rates) element(speed, "option", `${rate * data.dt_s}\u00d7`, { value: rate });
  speed.value = usual;
  const maps = cards.map((card) => new FeederMap(card.map, data, card.run, choose));
  const curves = new Curves(byId("curves"), byId("names"), data, (step) => go(step));

  function show() {
    const { step, bus } = replayState;
    time.value = step;
    const [each, unit] = data.time, decimals = each % 1 === 0 ? 0 : each < 0.1 ? 2 : 1;
    const t = (step * each).toFixed(decimals), end = (data.horizon * each).toFixed(0);
    byId("clock").textContent = `t = ${t} of ${end} ${unit}`;
    time.setAttribute("aria-valuetext", `${t} ${unit}`);
    cards.forEach(({ run, cost, state, reading }, r) => {
      const k = stepOf(run, step);
      cost.textContent = `so far ${figure(run.j[k], 3)} of ${figure(run.j[run.steps - 1], 3)}`;
      state.textContent = summary(data, run, step);
      reading.textContent = [`bus ${data.map.buses.id[bus]}: ${busWords(data, run, bus, step)[0]}`, ...busWords(data, run, bus, step).slice(1)].join(" \u00b7 ");
      maps[r].show(step, bus);
    });
    curves.show(step);
  }

  function go(step) {
    replayState.step = Math.min(data.last, Math.max(0, step));
    show();
  }

  function select(bus) {
    replayState.bus = bus;
    chooser.value = bus;
    byId("selected-title").textContent = `${busName(data, bus)[0].toUpperCase()}${busName(data, bus).slice(1)} over the episode`;
    curves.select(bus);
    show();
  }

  function choose(bus) {
    byId("hint").hidden = true;
    select(bus);
  }

  function play(on) {
    replayState.playing = on;
    const button = byId("play");
    button.textContent = on ? "\u23f8\ufe0e" : "\u25b6\ufe0e";
    button.setAttribute("aria-label", on ? "pause" : "play");
    if (!on) return;
    if (replayState.step >= data.last) go(0);
    let from = replayState.step, began = performance.now(), rate = Number(speed.value);
    const frame = (now) => {
      if (!replayState.playing) return;
      if (Number(speed.value) !== rate || Math.abs(replayState.step - from - Math.floor(((now - began) / 1000) * rate)) > 60) {
        [from, began, rate] = [replayState.step, now, Number(speed.value)];
      }
      const step = Math.min(data.last, from + Math.floor(((now - began) / 1000) * rate));
      if (step !== replayState.step) go(step);
      if (step >= data.last) play(false);
      else requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  function pausedAt(step) {
    play(false);
    go(step);
  }

  byId("play").addEventListener("click", () => play(!replayState.playing));
  byId("back").addEventListener("click", () => pausedAt(replayState.step - 1));
  byId("forward").addEventListener("click", () => pausedAt(replayState.step + 1));
  time.addEventListener("input", () => pausedAt(Number(time.value)));
  chooser.addEventListener("change", () => choose(Number(chooser.value)));
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape") hideTip();
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
    const by = event.shiftKey ? 10 : 1, { step } = replayState;
    const moves = { ArrowLeft: step - by, ArrowRight: step + by, Home: 0, End: data.last };
    if (event.key === " " && event.target.tagName !== "BUTTON") play(!replayState.playing);
    else if (event.key in moves) pausedAt(moves[event.key]);
    else return;
    event.preventDefault();
  });
  window.addEventListener("resize", () => fitMaps(data));
  window.addEventListener("scroll", hideTip);
  select(replayState.bus);
  byId("message").hidden = true;
  document.body.classList.remove("loading");
}

openReplay().catch((error) => {
  byId("message").textContent = `The replay could not be opened: ${error.message}. Try another browser, or write the file again.`;
  throw error;
});
