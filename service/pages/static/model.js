// A model: what it was trained on, how it was chosen, and how far it is off.

import { get, path } from "./api.js";
import { $, aside, colour, facts, h, names, panel, s, scroll, show, table } from "./dom.js";
import { fixed, hours, inUnit, number, plain, unit, words } from "./format.js";
import { keep } from "./live.js";
import { badge, notices } from "./states.js";

const UNITS = { mises: "MPa" }; // of what a surrogate knows beyond the outputs of the model
const percent = (value) => (value === undefined ? "–" : `${plain(value)} %`);

/** Errors of each quantity as rows: (quantity, where, median, 95th percentile, rmse, covers). */
function errorRows(errors, unitOf) {
  const rows = [];
  for (const [quantity, told] of Object.entries(errors ?? {})) {
    if (typeof told !== "object" || told === null) continue;
    const parts = Object.entries(told).filter(([, part]) => part && typeof part === "object");
    for (const [where, part] of parts) rows.push({ quantity, where: words(where), median: part.median_percent, p95: part.p95_percent, covers: told.coverage_95 });
    const rmse = Object.entries(told).filter(([name, v]) => name.includes("rmse") && typeof v === "number");
    for (const [name, value] of rmse) rows.push({ quantity, where: words(name.replace(/_mm$/, "")), rmse: value, unitName: name.endsWith("_mm") ? "mm" : unitOf(quantity), covers: told.coverage_95 });
  }
  return rows;
}

/** Bars on a logarithmic scale: the contest of surrogates. */
function bars(contest) {
  const tops = contest.map((c) => c.p95_percent);
  const [low, high] = [0.1, Math.max(100, ...tops)];
  const X = (v) => 118 + (Math.log(Math.max(v, low) / low) / Math.log(high / low)) * 200;
  const height = 30 + 26 * contest.length;
  const grid = [0.1, 1, 10, 100].map((v) => [
    s("line", { x1: X(v), x2: X(v), y1: 4, y2: height - 26, stroke: colour("grid") }),
    s("text", { x: X(v), y: height - 12, "text-anchor": "middle", "font-size": 11, fill: colour("soft") }, `${v}`)]);
  const rows = contest.map((c, i) => {
    const y = 18 + 26 * i;
    return [
      s("text", { x: 106, y: y + 4, "text-anchor": "end", "font-size": 12, fill: colour("ink") }, c.name),
      s("line", { x1: X(c.median_percent), x2: X(c.p95_percent), y1: y, y2: y, stroke: colour("parameters"), "stroke-width": 3 }),
      s("circle", { cx: X(c.median_percent), cy: y, r: 5, fill: colour("parameters") }),
      s("rect", { x: X(c.p95_percent) - 4, y: y - 5, width: 8, height: 10, fill: colour("late") })];
  });
  return s("svg", { viewBox: `0 0 340 ${height + 22}`, role: "img", class: "bars few", "aria-label": "Error of each candidate surrogate in percent, logarithmic; the table below has the numbers" },
    grid, rows, ["relative error of the elongation [%],", "logarithmic: ● median, ■ 95th percentile"].map((line, i) =>
      s("text", { x: 170, y: height + 4 + 14 * i, "text-anchor": "middle", "font-size": 11, fill: colour("soft") }, line)));
}

// How a model of a user's own runs does at runs that were left out, and what to mind.
function learnt(told) {
  const rows = Object.values(told.quality);
  const size = (v) => plain(v, 3);
  return [
    scroll("Held-out errors", table([
      { name: "Quantity", value: (q) => words(q.quantity), sort: (q) => q.quantity },
      { name: "Unit", value: (q) => unit(q.unit) },
      { name: "RMS", value: (q) => size(q.rms), sort: (q) => q.rms, number: true },
      { name: "95th percentile", value: (q) => size(q.p95), sort: (q) => q.p95, number: true },
      { name: "Spread of runs", value: (q) => size(q.spread), sort: (q) => q.spread, number: true },
      { name: "Noise expected", value: (q) => size(q.noise), sort: (q) => q.noise, number: true },
      { name: "Verdict", value: (q) => q.verdict, sort: (q) => q.verdict },
      { name: "Worst run", value: (q) => `${q.worst} (${size(q.worst_rms)})` },
    ], rows)),
    told.warnings?.length ? h("ul", {}, told.warnings.map((w) => h("li", {}, `${w.field}: ${w.value ?? ""} ${w.problem}.`))) : null];
}

keep(async () => {
  const model = await get(path`/v1/models/${names.m}`);
  notices([]);
  const told = model.summary;
  show($("states"), badge(model.state === "ready" ? "ok" : "wait", model.state));
  const rows = errorRows(told.errors, (quantity) => model.outputs[quantity]?.unit ?? UNITS[quantity]);
  const what = panel("What it is", facts([
    ["Version", h("code", {}, model.version)],
    ["Covers", `0 … ${hours(model.horizon_h)}`],
    ["Mesh", model.node_count > 1 ? `${number(model.node_count, "node")}${told.mesh ? `, ${told.mesh}` : ""}` : "none"],
    ["Named nodes", Object.entries(model.nodes).map(([name, n]) => `${name}: ${n}`).join(", ") || "none"],
    told.source && ["Runs", told.source],
    told.training && ["Trained on", `${number(told.training.runs, "run")}, seed ${told.training.seed}`],
    told.runs?.test && ["Measured on", `${number(told.runs.test, "run")} that it never saw`],
    told.command && ["Made by", h("code", {}, told.command)],
    told.finite_elements && ["Finite elements", h("code", {}, told.finite_elements.digest.slice(0, 16))],
    ["Digest", h("code", {}, model.digest)],
  ]));
  const errors = panel("Errors on runs it never saw; how often its own 95 % interval covers", rows.length
    ? scroll("Errors", table([
        { name: "Quantity", value: (r) => words(r.quantity), sort: (r) => r.quantity },
        { name: "Where", value: (r) => r.where },
        { name: "Median", value: (r) => percent(r.median), sort: (r) => r.median, number: true },
        { name: "95th percentile", value: (r) => percent(r.p95), sort: (r) => r.p95, number: true },
        { name: "RMSE", value: (r) => (r.rmse === undefined ? "–" : inUnit(plain(r.rmse, 3), r.unitName)), number: true },
        { name: "95 % covers", value: (r) => (r.covers === undefined ? "–" : `${fixed(100 * r.covers, 1)} %`), number: true },
      ], rows))
    : told.quality ? learnt(told) : h("p", { class: "soft" }, "The model tells no errors: it is a closed form, or does not say."));
  const contest = told.contest?.length
    ? panel("The contest of surrogates", bars(told.contest), aside("As a table", table([
        { name: "Candidate", value: (c) => c.name, sort: (c) => c.name },
        { name: "Median [%]", value: (c) => plain(c.median_percent), sort: (c) => c.median_percent, number: true },
        { name: "95th percentile [%]", value: (c) => plain(c.p95_percent), sort: (c) => c.p95_percent, number: true },
      ], told.contest)))
    : null;
  const network = panel("Network",
    table([
      { name: "Parameter", value: (p) => words(p.name), sort: (p) => p.name },
      { name: "Level", value: (p) => p.level, sort: (p) => p.level },
      { name: "Prior", value: (p) => `${words(p.prior.kind)}, ${plain(p.prior.low)} … ${plain(p.prior.high)}` },
      { name: "Unit", value: (p) => p.unit },
    ], model.network.parameters, { caption: "Parameters" }),
    table([
      { name: "Quantity", value: (q) => words(q.name), sort: (q) => q.name },
      { name: "Kind", value: (q) => q.kind },
      { name: "Unit", value: (q) => q.unit },
      { name: "Noise, prior", value: (q) => `${words(q.sigma_obs.kind)}, ${plain(q.sigma_obs.low)} … ${plain(q.sigma_obs.high)} ${unit(q.unit)}` },
    ], model.network.quantities, { caption: "Quantities" }));
  show($("page"), h("div", { class: "columns ring-left" }, h("div", { class: "stack" }, what, contest), h("div", { class: "stack" }, errors, network)));
});
