// A blade: what is predicted and from what, what was measured, and how the belief moved.

import { usualHours } from "./ahead.js";
import { get, pages, path } from "./api.js";
import { chart, legend, numbers } from "./chart.js";
import { corner, marginals } from "./corner.js";
import { $, asked, h, names, panel, remember, scroll, select, show, table } from "./dom.js";
import { withEffects } from "./effects.js";
import { asGiven, fixed, hours, hoursOf, inUnit, number, percent, plain, unit, withSd, words } from "./format.js";
import { drawn, follow, keep } from "./live.js";
import { since } from "./since.js";
import { badge, badges, notices, statesOf, warningsOf } from "./states.js";
import { kindsOf, readingsTable } from "./reading.js";

const [rotor, blade] = [names.r, names.b];
const url = path`/v1/rotors/${rotor}`;
const own = path`/v1/rotors/${rotor}/blades/${blade}`;
const chosen = { quantity: asked("quantity"), limit: asked("limit"), component: Number(asked("component") ?? 2) };
const SOURCES = [["parameters", "line"], ["surrogate", "dash"], ["discrepancy", "dot"], ["noise", "dash"], ["total", "line"]];
const AXES = ["x", "y", "z"];
const ROWS = 200; // of readings in the table; the chart has them all
const [bands, bandsLegend, bandsTable, sources, sourcesTable, figures, list, history, prior, pairs, controls] =
  Array.from({ length: 11 }, () => h("div"));
controls.className = "controls";
let model = null;
let shown = "";

const part = (values) => (Array.isArray(values[0]) ? values.map((v) => v[chosen.component]) : values);

function change(given) {
  Object.assign(chosen, given);
  remember(given);
  shown = "";
  redraw();
}

function drawControls(found) {
  const text = JSON.stringify([found.quantity, chosen.component]);
  if (text === shown) return;
  shown = text;
  const kind = model.outputs[found.quantity].kind;
  show(controls,
    select("Quantity", Object.keys(model.outputs).map((q) => [q, words(q)]), found.quantity, (q) => change({ quantity: q, limit: null })),
    kind === "vector" ? select("Direction", AXES.map((a, i) => [i, a]), chosen.component, (c) => change({ component: Number(c) })) : null,
    found.node === null ? null : h("span", { class: "soft" }, `node ${found.node} (${Object.keys(model.nodes).find((n) => model.nodes[n] === found.node) ?? "as asked"})`),
    h("label", {}, "Limit", h("input", { type: "number", step: "any", value: chosen.limit ?? "", onchange: (e) => change({ limit: e.target.value || null }) }), unit(found.unit)));
}

function drawBands(found, readings, life) {
  const mean = part(found.mean);
  const sd = Object.fromEntries(Object.entries(found.sd).map(([name, values]) => [name, part(values)]));
  const bladeSd = sd.total.map((total, i) => Math.sqrt(Math.max(0, total ** 2 - sd.noise[i] ** 2)));
  const around = (width, k) => [mean.map((m, i) => m + k * width[i]), mean.map((m, i) => m - k * width[i])];
  const limit = chosen.limit ? Number(chosen.limit) : null;
  const marks = readings.filter((r) => r.quantity === found.quantity && r.values?.length)
    .flatMap((r) => {
      const at = r.nodes ? r.nodes.indexOf(found.node) : 0;
      const value = at < 0 ? undefined : r.values[at];
      return value === undefined ? [] : [{ kind: r.kind, time_h: r.time_h, value: Array.isArray(value) ? value[chosen.component] : value }];
    });
  const what = `${words(found.quantity)}${Array.isArray(found.mean[0]) ? `, ${AXES[chosen.component]}` : ""}`;
  const kinds = [...new Set(marks.map((m) => m.kind))];
  chart(bands, {
    time: found.time_h, lines: [{ name: "mean", values: mean, ink: "mean" }], what, unitName: found.unit, height: 360, marks,
    bands: [[...around(sd.total, 2), 0.16], [...around(bladeSd, 2), 0.2], [...around(bladeSd, 1), 0.25]],
    across: limit === null ? [] : [{ value: limit, name: `limit ${inUnit(asGiven(limit), found.unit)}` }],
    label: `${what} over operating hours: mean, ±1 and ±2 sd of the blade, ±2 sd of a reading, ${number(marks.length, "reading")}`,
  });
  show(bandsLegend, legend([["line", "mean", "mean"], ["strong", "band", "blade ±1 sd, ±2 sd (without noise)"], ["light", "band", "next reading ±2 sd (with noise)"],
    ...kinds.map((kind) => ["mark", kind, { counts: "counts", late: "late", corrects: "correction", replaced: "replaced", retracted: "retracted" }[kind]])]));
  const hidden = readings.filter((r) => r.quantity === found.quantity).length - marks.length;
  if (hidden > 0) bandsLegend.append(h("p", { class: "small soft" }, `${number(hidden, "scan")} of this quantity not drawn here (other nodes, or many at once): see In 3-D.`));
  const lines = SOURCES.map(([name, way]) => ({ name, way, values: sd[name], ink: name }));
  show(bandsTable, numbers("Prediction as a table", found.time_h, [{ name: "mean", values: mean }, { name: "sd of the blade", values: bladeSd }, { name: "sd of a reading", values: sd.total }], found.unit));
  chart(sources, { time: found.time_h, lines, what: `sd of ${what}`, unitName: found.unit, height: 210, least: 0, label: `Standard deviation by source over operating hours` });
  show(sourcesTable, legend(SOURCES.map(([name, way]) => [way, name, name])),
    h("p", { class: "small soft" }, "The squares of the sources add up to the square of the total."),
    numbers("Sources as a table", found.time_h, lines, found.unit));
  drawFigures(found, mean, sd, bladeSd, life);
}

function drawFigures(found, mean, sd, bladeSd, life) {
  const last = mean.length - 1;
  const figure = (text, more) => h("p", {}, h("span", { class: "figure" }, text), h("br"), h("span", { class: "soft small" }, more));
  const parts = [figure(inUnit(withSd(mean[last], bladeSd[last]), found.unit), `at ${hours(found.time_h[last])}: the blade itself; a reading then: ± ${inUnit(plain(sd.total[last], 2), found.unit)}`)];
  if (life === null) parts.push(h("p", { class: "soft" }, "Give a limit above to see the time to it."));
  else {
    const last = life.time_h.at(-1);
    const end = last < 10 ? hoursOf(last, last) : hours(last);
    const at = (share) => (life.quantiles[share] === null ? `beyond ${end}` : hoursOf(life.quantiles[share], last));
    parts.push(figure(at("0.5"), `median time to ${inUnit(asGiven(life.limit), life.unit)}`),
      h("p", { class: "small" }, `5 %: ${at("0.05")}; 95 %: ${at("0.95")}. Chance to have passed it by ${end}: ${percent(life.passed.at(-1))}.`),
      h("p", { class: "small soft" }, "From all particles of the blade at each hour, without a reading's noise. What falls passes a limit from above; what begins at it has passed it at hour 0."));
  }
  show(figures, parts);
}

/** A version in which the blade was not yet, or that is thinned out by now; all else is told. */
const notThen = (error) => {
  if (error.status === 404 || error.status === 410) return null;
  throw error;
};

async function drawHistory(found, kept, came, adoptions, joined) {
  const last = found.time_h.at(-1);
  const told = await Promise.all(kept.items.map((v) => v.through_seq < joined ? null :
    get(`${own}/prediction`, { version: v.version, quantity: found.quantity, times: last, node: found.node }).catch(notThen)));
  const rows = kept.items.map((v, i) => {
    const since = kept.items[i + 1]?.through_seq ?? (kept.next === null ? 0 : null);
    const readings = since === null ? [] : came.items.filter((r) => r.seq > since && r.seq <= v.through_seq);
    const mean = told[i] && part(told[i].mean)[0];
    const sd = told[i] && Math.sqrt(Math.max(0, part(told[i].sd.total)[0] ** 2 - part(told[i].sd.noise)[0] ** 2));
    return { ...v, since, readings, mean, sd };
  });
  rows.forEach((row, i) => {
    const before = rows[i + 1];
    row.moved = before && row.mean !== null && before.mean !== null ? (row.mean - before.mean) / before.sd : null;
  });
  const why = (row) => {
    if (row.since === null) return "older entries";
    const count = row.through_seq - row.since;
    if (count === 0) return "sealed, no new entries";
    const here = row.readings.filter((r) => r.blade === blade);
    const few = here.slice(0, 3).map((r) => r.id).join(", ");
    const changed = adoptions.items.filter((one) => one.seq > row.since && one.seq <= row.through_seq && one.what !== "joining")
      .map((one) => `; ${one.what === "adoption" ? "adopted" : "backed out"}: ${one.effects.map((e) => e.name).join(", ")}`);
    return `${number(count, "entry", "entries")}${changed.join("")}${here.length ? `; this blade: ${few}${here.length > 3 ? " …" : ""}` : changed.length === count ? "" : "; no new reading of this blade"}`;
  };
  const columns = [
    { name: "Version", value: (v) => fixed(v.version, 0), number: true },
    { name: "State", value: (v) => badge(v.health.trusted ? (v.sealed ? "ok" : "wait") : "bad", v.health.trusted ? (v.sealed ? "sealed" : "provisional") : v.health.status) },
    { name: "Through", value: (v) => fixed(v.through_seq, 0), number: true },
    { name: `At ${hours(last)}${unit(found.unit) ? ` [${found.unit}]` : ""}`, value: (v) => (v.mean === null ? "blade not in it" : withSd(v.mean, v.sd)), number: true },
    { name: "Moved [sd]", value: (v) => fixed(v.moved, 2), number: true },
    { name: "What came", value: why },
    { name: "Computed", value: (v) => since(v.created_at) },
  ];
  show(history, scroll("Versions", table(columns, rows, { caption: "The newest kept versions; moved: change of the mean in sd of the version before" })));
}

/** When the blade passes the limit that was given; null: none was. */
async function lifeOf(found) {
  const limit = Number(chosen.limit);
  if (!chosen.limit || !Number.isFinite(limit)) return null;
  const given = new URLSearchParams({ limit, quantity: found.quantity });
  if (found.node !== null) given.set("node", found.node);
  if (Array.isArray(found.mean[0])) given.set("component", AXES[chosen.component]);
  return get(`${own}/life?${given}`); // a limit of ours, not a page's length
}

async function draw() {
  model ??= await get(path`/v1/models/${(await get(url)).model}`);
  const rest = Promise.all([
    get(`${own}/prediction`, { quantity: chosen.quantity, times: usualHours(model) }), pages(`${url}/inspections`, { blade, newest: true }, 2000),
    get(`${own}/draws`, { count: 1000 }), get(`${url}/versions`, { limit: 8 }), get(`${url}/inspections`, { newest: true, limit: 200, blade }), pages(`${url}/adoptions`)]);
  rest.catch(() => {}); // what went wrong is told where it is waited for
  const now = await get(url);
  drawn.version = now.version;
  const me = now.blades.find((b) => b.id === blade);
  const states = badges(statesOf(now));
  if (me?.retired) states.push(badge("wait", "retired"));
  if (me) states.push(h("span", { class: "soft" }, [me.slot && ["slot ", me.slot], me.lot && ["lot ", me.lot], me.coating_lot && ["coating lot ", me.coating_lot]].filter(Boolean)
    .map(([what, name], i) => [i ? " · " : "", what, h("bdi", {}, name)])));
  show($("states"), states);
  const [nearer, all, draws, kept, came, adoptions] = await rest;
  let found = nearer;
  drawn.version = Math.min(found.rests_on.version, draws.rests_on.version);
  if (drawn.version < now.version) redraw(); // these were answered before it was there
  const readings = kindsOf(all.items);
  const latest = Math.max(0, ...readings.map((r) => r.time_h));
  if (latest > found.time_h.at(-1)) found = await get(`${own}/prediction`, { quantity: chosen.quantity, times: usualHours(model, latest) });
  notices([...warningsOf(now), readings.length === 0 && ["wait", "No reading of this blade yet: what is shown is what the rotor tells of it."],
    found.held_from_h !== null && ["warn", `From ${hours(found.held_from_h)} on an adopted effect stays as it is by then: it would take an input of this blade out of the model’s runs, or how it goes on is not known.`,
      "Later hours have too little of the effect."],
    all.more && ["wait", "Only the newest 2 000 readings of this blade are drawn."]]);
  drawControls(found);
  drawBands(found, readings, await lifeOf(found));
  show(list, readings.length ? readingsTable(rotor, readings.slice(-ROWS), { blade: false }) : h("p", { class: "soft" }, "None yet."),
    readings.length > ROWS ? h("p", { class: "small" }, `The last ${ROWS} to arrive of ${all.more ? "more than " : ""}${fixed(readings.length, 0)}. `, h("a", { href: `${path`/rotors/${rotor}/readings`}?blade=${encodeURIComponent(blade)}` }, "All of them, page by page")) : null);
  marginals(prior, draws, withEffects(model.network, now.network?.effects));
  corner(pairs, draws);
  await drawHistory(found, kept, came, adoptions, me?.added_seq ?? 0);
}

show($("page"),
  h("div", { class: "columns wide-left" },
    panel("Prediction", controls, bands, bandsLegend, bandsTable),
    h("div", { class: "stack" }, panel("At the end", figures), panel("Uncertainty by source", sources, sourcesTable))),
  h("div", { class: "columns halves late" }, panel("Readings of this blade", list), panel("How the belief moved", history)),
  h("div", { class: "columns halves late" }, panel("Prior against posterior", prior), panel("Parameters in pairs", pairs)));
const redraw = keep(draw);
follow(rotor, redraw);
