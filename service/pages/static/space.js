// A blade in 3-D: a field of it on the model's mesh, at any hour, with the nodes that were scanned.

import { usual } from "./ahead.js";
import { Problem, get, pages, path } from "./api.js";
import { $, aside, asked, h, names, panel, remember, s, scroll, select, show, table } from "./dom.js";
import { axis, hours, inUnit, labels, number, plain, unit, words } from "./format.js";
import { drawn, follow, keep } from "./live.js";
import { apart, css, share, span, ticks } from "./scale.js";
import { badges, notices, statesOf, warningsOf } from "./states.js";
import { View, possible } from "./view.js";

const [rotor, blade] = [names.r, names.b];
const own = path`/v1/rotors/${rotor}/blades/${blade}`;
const AXES = ["x", "y", "z"];
const chosen = { quantity: asked("quantity"), time_h: asked("time_h"), of: asked("of") ?? "mean", axis: Number(asked("axis") ?? 2), warp: Number(asked("warp") ?? 0), scan: asked("scan") };
const canvas = h("canvas", { tabindex: 0, role: "img" });
const holder = h("div", { class: "space" }, canvas);
const [controls, film, bar, misfit, values, scans] = Array.from({ length: 6 }, () => h("div"));
const INSTANTS = 11;
const FRAME_MS = 350;
controls.className = film.className = "controls";
let model = null;
let surface = null;
let view = null;
let shown = "";
let shownHour = null;
let slider = null;
let films = 0;
let playing = 0; // number of the film that runs; 0: none
let dots = [];
let series = { key: "", fields: [] };

function change(given, again = true) {
  if (playing) stop();
  Object.assign(chosen, given);
  remember(given);
  if (again) shown = "";
  redraw();
}

function drawControls(fields, found, kind) {
  const text = JSON.stringify([found.quantity, kind]);
  if (text === shown) return;
  shown = text;
  shownHour = h("output", { for: "hour", "aria-live": "off" }, hours(found.time_h));
  slider = h("input", { id: "hour", type: "range", min: 0, max: model.horizon_h, step: model.horizon_h / 100, value: found.time_h,
    oninput: (event) => { stop(); shownHour.textContent = hours(Number(event.target.value)); },
    onchange: (event) => change({ time_h: event.target.value }, false) });
  show(controls,
    select("Quantity", fields.map((q) => [q, words(q)]), found.quantity, (q) => change({ quantity: q })),
    kind === "vector" ? select("Direction", AXES.map((a, i) => [i, i === 2 ? "z (radius)" : i === 0 ? "x (rotor's axis)" : "y"]), chosen.axis, (a) => change({ axis: Number(a) })) : null,
    select("Show", [["mean", "mean"], ["sd", "sd"]], chosen.of, (of) => change({ of })),
    kind === "vector" ? select("Shape moved", [[0, "not"], [50, "50 ×"], [200, "200 ×"]], chosen.warp, (warp) => change({ warp: Number(warp) })) : null,
    h("label", { for: "hour" }, "Hours", slider), shownHour);
}

function colourBar(range, what, unitName, colour = css) {
  const at = ticks(range, 5);
  const X = (v) => 20 + 360 * share(v, range);
  return s("svg", { viewBox: "0 0 400 52", class: "bar", role: "img", "aria-label": `Colours of ${what}: ${plain(range[0])} to ${plain(range[1])} ${unit(unitName)}` },
    Array.from({ length: 90 }, (_, i) => s("rect", { x: 20 + 4 * i, y: 4, width: 4.2, height: 12, fill: colour((i + 0.5) / 90), "shape-rendering": "crispEdges" })),
    labels(at).map((text, i) => s("text", { x: X(at[i]), y: 30, "text-anchor": "middle", class: "tick" }, text)),
    s("text", { x: 200, y: 47, "text-anchor": "middle", class: "tick" }, axis(what, unitName)));
}

const component = (of) => (Array.isArray(of[0]) ? of.map((v) => v[chosen.axis]) : of);
const called = (found) => `${chosen.of} of ${words(found.quantity)}${Array.isArray(found.mean[0]) ? `, ${AXES[chosen.axis]},` : ""}`;
const shownOf = (found) => component(chosen.of === "sd" ? found.sd : found.mean);
const shift = (found) => (chosen.warp && Array.isArray(found.mean[0]) ? found.mean.flat().map((v) => chosen.warp * v) : null);

/** Ends the film. */
function stop() {
  playing = 0;
  show(film, h("button", { type: "button", onclick: play, disabled: !view }, "Play over the hours"));
}

/**
 * The field at evenly spread hours, read once, shown one after the other in the same colours. News
 * of the rotor does not end the film: it is of the version that it names.
 */
async function play() {
  stop();
  films += 1;
  const mine = films;
  playing = mine;
  const version = drawn.version;
  const told = h("span", { class: "soft small", role: "status" });
  const shows = h("span", { class: "soft small" }); // changes too often to be said
  show(film, h("button", { type: "button", class: "main", onclick: () => { stop(); redraw(); } }, "Stop"), told, shows);
  const hoursOf = Array.from({ length: INSTANTS }, (_, i) => (model.horizon_h * i) / (INSTANTS - 1));
  const quantity = chosen.quantity ?? Object.keys(model.outputs).find((q) => model.outputs[q].kind !== "scalar");
  const key = JSON.stringify([quantity, version]);
  if (series.key !== key) series = { key, fields: [] };
  const { fields } = series;
  try {
    while (fields.length < INSTANTS) {
      told.textContent = `reading instant ${fields.length + 1} of ${INSTANTS}`;
      const next = await get(`${own}/field`, { quantity, time_h: hoursOf[fields.length], version });
      if (mine !== playing) return;
      fields.push(next);
    }
  } catch (error) {
    if (mine === playing) {
      playing = 0;
      told.textContent = error.message;
    }
    if (!(error instanceof Problem)) throw error;
    return;
  }
  const used = [...new Set(surface.triangles.flat())];
  show(misfit); // it is of one hour
  view.mark(dots);
  for (let i = 0; mine === playing; i = (i + 1) % INSTANTS) {
    const range = span(fields.flatMap((one) => { const all = shownOf(one); return used.map((n) => all[n]); }));
    view.paint(shownOf(fields[i]), range, shift(fields[i]));
    const what = `${called(fields[i])} from ${hours(0)} to ${hours(model.horizon_h)}`;
    show(bar, colourBar(range, what, fields[i].unit));
    slider.value = hoursOf[i];
    shownHour.textContent = hours(hoursOf[i]);
    told.textContent = "";
    shows.textContent = `instant ${i + 1} of ${INSTANTS}, version ${version}`;
    await new Promise((done) => setTimeout(done, FRAME_MS));
  }
}

/** What a scan says beyond the posterior at each of its nodes, as colours, a bar and a table. */
function drawMisfit(scan, found) {
  const nodes = scan?.nodes ?? [];
  if (nodes.length === 0 || Math.abs(scan.time_h - found.time_h) > 1e-6) {
    show(misfit);
    return null;
  }
  const [mean, sd, read] = [component(found.mean), component(found.sd), component(scan.values)];
  const off = nodes.map((n, i) => ({ node: n, off: read[i] - mean[n], read: read[i], mean: mean[n], sd: sd[n] }));
  const top = Math.max(...off.map((one) => Math.abs(one.off))) || 1;
  const rms = Math.sqrt(off.reduce((sum, one) => sum + one.off ** 2, 0) / off.length);
  const bias = off.reduce((sum, one) => sum + one.off, 0) / off.length;
  const range = [-top, top];
  const axisName = Array.isArray(found.mean[0]) ? `, ${AXES[chosen.axis]}` : "";
  const what = `scan ${scan.id} less prediction${axisName}`;
  show(misfit, h("p", { class: "small" }, `At its ${number(nodes.length, "node")}: root mean square ${inUnit(plain(rms), found.unit)}, mean ${inUnit(plain(bias), found.unit)}. The posterior knows this scan already.`),
    colourBar(range, what, found.unit, (v) => `rgb(${apart(v).map(Math.round).join(", ")})`),
    aside("Misfit at each node as a table", scroll("Misfit", table([
      { name: "Node", value: (one) => one.node, sort: (one) => one.node, number: true },
      { name: "Scan", value: (one) => plain(one.read, 4), sort: (one) => one.read, number: true },
      { name: "Prediction", value: (one) => plain(one.mean, 4), sort: (one) => one.mean, number: true },
      { name: "± sd", value: (one) => plain(one.sd, 2), sort: (one) => one.sd, number: true },
      { name: "Misfit", value: (one) => plain(one.off), sort: (one) => Math.abs(one.off), number: true },
    ], off.slice(0, 500), { caption: off.length > 500 ? `The first 500 of ${off.length} nodes` : null }))));
  return off.map((one) => apart(share(one.off, range)));
}

/** Nodes of the scans of a quantity, and the scans. */
async function scanned(quantity) {
  const all = await pages(path`/v1/rotors/${rotor}/inspections`, { blade, newest: true }, 2000);
  const of = all.items.filter((r) => r.quantity === quantity && r.status === "counts").slice(0, 20).reverse();
  return Promise.all(of.map(async (r) => (r.nodes ? r : get(path`/v1/rotors/${rotor}/inspections/${r.id}`))));
}

async function draw() {
  const now = await get(path`/v1/rotors/${rotor}`);
  drawn.version = now.version;
  show($("states"), badges(statesOf(now)));
  if (playing) {
    notices(warningsOf(now)); // what the film shows stays; its end draws the newest
    return;
  }
  model ??= await get(path`/v1/models/${now.model}`);
  const fields = Object.keys(model.outputs).filter((q) => model.outputs[q].kind !== "scalar");
  if (fields.length === 0) {
    show($("page"), h("p", {}, `Model ${model.id} has no fields: nothing to show in 3-D.`));
    notices([]);
    return;
  }
  surface ??= await get(path`/v1/models/${now.model}/surface`);
  const quantity = fields.includes(chosen.quantity) ? chosen.quantity : fields[0];
  const found = await get(`${own}/field`, { quantity, time_h: chosen.time_h ?? usual(model) });
  if (playing) return; // begun meanwhile
  const kind = model.outputs[quantity].kind;
  const numbers = shownOf(found);
  const used = [...new Set(surface.triangles.flat())];
  const range = span(used.map((n) => numbers[n]));
  const what = `${called(found)} at ${hours(found.time_h)}`;
  const able = possible();
  notices([...warningsOf(now), surface.version !== found.rests_on.model_version && ["warn", "The mesh is of another version of the model than this posterior."],
    !able && ["warn", "This browser draws nothing in 3-D (WebGL 2 is missing or off). The numbers are in the table."]]);
  drawControls(fields, found, kind);
  slider.value = found.time_h;
  shownHour.textContent = hours(found.time_h);
  if (able) {
    view ??= new View(canvas, surface);
    view.paint(numbers, range, shift(found));
  } else holder.hidden = true;
  canvas.setAttribute("aria-label", `${what} of blade ${blade} on its surface; arrow keys turn it, plus and minus zoom, Home resets`);
  show(bar, colourBar(range, what, found.unit));
  const extreme = (better) => used.reduce((a, b) => (better(numbers[b], numbers[a]) ? b : a));
  const rows = [...Object.entries(model.nodes).map(([name, n]) => [name, n]), ["greatest", extreme((a, b) => a > b)], ["least", extreme((a, b) => a < b)]];
  const at = (v) => (kind === "vector" ? v[chosen.axis] : v);
  show(values, scroll("Numbers", table([
    { name: "Where", value: ([name]) => name },
    { name: "Node", value: ([, n]) => n, number: true },
    { name: `Mean${unit(found.unit) ? ` [${found.unit}]` : ""}`, value: ([, n]) => plain(at(found.mean[n])), number: true },
    { name: "± sd", value: ([, n]) => plain(at(found.sd[n]), 2), number: true },
  ], rows, { caption: `${what}; on ${number(found.particles, "particle")}` })),
  aside("Every hundredth node", scroll("Nodes", table([
    { name: "Node", value: (n) => n, sort: (n) => n, number: true },
    ...AXES.map((a, k) => ({ name: `${a} [mm]`, value: (n) => plain(surface.points[n][k], 4), number: true })),
    { name: "Mean", value: (n) => plain(at(found.mean[n])), sort: (n) => at(found.mean[n]), number: true },
    { name: "± sd", value: (n) => plain(at(found.sd[n]), 2), sort: (n) => at(found.sd[n]), number: true },
  ], used.filter((_, i) => i % 100 === 0)))));
  const scansOf = await scanned(quantity);
  if (playing) return;
  const looked = scansOf.find((r) => r.id === chosen.scan);
  const colours = drawMisfit(looked, found);
  dots = [...new Set(scansOf.flatMap((r) => r.nodes ?? []))];
  if (view) view.mark(colours ? looked.nodes : dots, colours);
  show(scans, scansOf.length ? scroll("Scans", table([
    { name: "Scan", value: (r) => r.id },
    { name: "Misfit", value: (r) => (r.nodes?.length ? h("button", { type: "button", "aria-pressed": String(Boolean(colours) && r === looked), onclick: () => change(colours && r === looked ? { scan: null } : { scan: r.id, time_h: r.time_h }) }, colours && r === looked ? "Hide" : "Show") : "–") },
    { name: "Hours", value: (r) => hours(r.time_h), number: true },
    { name: "Nodes", value: (r) => (r.nodes ?? []).length, number: true },
    { name: "Mean of readings", value: (r) => inUnit(plain(r.values.reduce((sum, v) => sum + (Array.isArray(v) ? v[chosen.axis] : v), 0) / r.values.length), r.unit ?? found.unit), number: true },
  ], scansOf, { caption: "Scans of this quantity that count; their nodes are the orange dots; the misfit of one is shown at its own hour" })) : h("p", { class: "soft" }, `No scan of ${words(quantity)} on this blade.`));
  stop(); // the film can begin once all is drawn
}

show($("page"), h("div", { class: "columns wide-left" },
  panel(null, controls, film, holder, bar, misfit, h("p", { class: "small soft" }, "Drag or arrow keys turn, wheel or + and − zoom, Home resets.")),
  h("div", { class: "stack" }, panel("Numbers", values), panel("Scans", scans))));
const redraw = keep(draw);
follow(rotor, redraw);
