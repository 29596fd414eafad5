// Residuals of a rotor: every reading against its prediction from before it was used, and tests.

import { get, path } from "./api.js";
import { $, across, aside, asked, colour, facts, h, names, panel, remember, s, scroll, select, show, table } from "./dom.js";
import { fixed, hoursAlone, inUnit, labels, moment, number, plain, withSd, words } from "./format.js";
import { ORDERS, heat } from "./heat.js";
import { drawn, follow, keep } from "./live.js";
import { ticks } from "./scale.js";
import { badges, badge, notices, statesOf, warningsOf } from "./states.js";

const url = path`/v1/rotors/${names.r}`;
const MOST = 2000;
const LARGEST = 40;
const ASKED = { campaign: "campaign", instrument: "instrument", lot: "lot", coating_lot: "coating lot", quantity: "quantity", blade: "blade" };
const chosen = { by: asked("by") in ASKED ? asked("by") : "campaign", order: asked("order") in ORDERS ? asked("order") : "blade" };

/** All residuals up to MOST, page by page; the last page's answer has the tests. */
async function readAll() {
  const items = [];
  let told;
  let cursor = null;
  do {
    told = await get(`${url}/residuals`, { cursor });
    items.push(...told.items);
    cursor = told.next;
  } while (cursor !== null && items.length < MOST);
  return { ...told, items, more: cursor !== null };
}

const INKS = ["parameters", "late", "discrepancy", "noise", "prior"];

const labelled = (values) => labels(values).map((label, i) => [values[i], label]);

/** z against the rotor's hours: a point a reading, its group by ink, ±2 sd as lines. */
function scatter(items) {
  const groups = [...new Set(items.map((r) => r[chosen.by] ?? "–"))].sort((a, b) => String(a).localeCompare(String(b), "en", { numeric: true }));
  const few = groups.length <= INKS.length;
  const ink = (r) => colour(few ? INKS[groups.indexOf(r[chosen.by] ?? "–")] : "total") || colour("total");
  const [left, right, top, bottom, height] = [52, 860, 12, 268, 308];
  const hours = items.map((r) => r.rotor_h);
  const last = Math.max(...hours, 1);
  const reach = Math.max(3.2, ...items.map((r) => Math.abs(r.z))) * 1.05;
  const X = (t) => left + (t / (1.05 * last)) * (right - left);
  const beside = (r, i) => X(r.rotor_h) + 9 * (((i * 0.618) % 1) - 0.5); // readings of one visit side by side
  const Y = (z) => top + ((reach - z) / (2 * reach)) * (bottom - top);
  const grid = (z, strong) => s("line", { x1: left, x2: right, y1: Y(z), y2: Y(z), stroke: colour(strong ? "soft" : "line"), "stroke-dasharray": strong ? null : "6 4" });
  const text = (x, y, what, anchor) => s("text", { x, y, "text-anchor": anchor, "font-size": 12, fill: colour("soft") }, what);
  const picture = s("svg", { class: "bars wide", viewBox: `0 0 880 ${height}`, role: "img", "aria-label": "Residuals in standard deviations over the rotor's hours; the table below has the largest" },
    grid(0, true), grid(2, false), grid(-2, false),
    labelled(ticks([-reach, reach], 7)).map(([z, label]) => text(left - 8, Y(z) + 4, label, "end")),
    labelled(ticks([0, last], 8)).map(([t, label]) => text(X(t), bottom + 18, label, "middle")),
    text((left + right) / 2, height - 6, "rotor's hours [h]", "middle"),
    s("text", { x: 14, y: (top + bottom) / 2, "text-anchor": "middle", "font-size": 12, fill: colour("soft"), transform: `rotate(-90 14 ${(top + bottom) / 2})` }, "z [sd]"),
    items.map((r, i) => s("circle", { cx: beside(r, i), cy: Y(r.z), r: 3.5, fill: ink(r), "fill-opacity": 0.75 },
      s("title", {}, `${r.blade}, ${words(r.quantity)}, ${fixed(r.rotor_h, 0)} h: z = ${fixed(r.z, 2)}`))));
  const legend = few ? h("ul", { class: "legend" }, groups.map((g, i) => h("li", {}, s("svg", { width: 12, height: 12, "aria-hidden": "true" }, s("circle", { cx: 6, cy: 6, r: 4, fill: colour(INKS[i]) || colour("total") })), String(g)))) : h("p", { class: "small" }, `${groups.length} groups by ${ASKED[chosen.by]}: more than there are colours, so that all have one.`);
  return [across("Residuals over the rotor's hours", picture), legend];
}

const columns = [
  { name: "Of", value: (t) => (t.value === null ? words(t.grouping) : `${words(t.grouping)} ${t.value}`), sort: (t) => `${t.grouping} ${t.value ?? ""}` },
  { name: "Asks for", value: (t) => words(t.statistic), sort: (t) => t.statistic },
  { name: "Residuals", value: (t) => fixed(t.count, 0), sort: (t) => t.count, number: true },
  { name: "Score [sd]", value: (t) => fixed(t.score, 1), sort: (t) => Math.abs(t.score), number: true },
  { name: "p", value: (t) => plain(t.p, 2), sort: (t) => t.p, number: true },
  { name: "p among all", value: (t) => plain(t.p_family, 2), sort: (t) => t.p_family, number: true },
  { name: "", value: (t) => (t.alarm ? badge("bad", "alarm") : "") },
];

function largest(items, units) {
  const rows = [...items].sort((a, b) => Math.abs(b.z) - Math.abs(a.z)).slice(0, LARGEST);
  return scroll("Largest residuals", table([
    { name: "Blade", value: (r) => h("a", { href: path`/rotors/${names.r}/blades/${r.blade}` }, r.blade), sort: (r) => r.blade, called: true },
    { name: "Quantity", value: (r) => words(r.quantity), sort: (r) => r.quantity },
    { name: "Hours [h]", value: (r) => hoursAlone(r.time_h), sort: (r) => r.time_h, number: true },
    { name: "Campaign", value: (r) => r.campaign ?? "–", sort: (r) => r.campaign, called: true },
    { name: "Instrument", value: (r) => r.instrument ?? "–", sort: (r) => r.instrument, called: true },
    { name: "Read", value: (r) => inUnit(plain(r.y, 4), units[r.quantity]), number: true },
    { name: "Predicted before", value: (r) => inUnit(withSd(r.mean, r.sd), units[r.quantity]), number: true },
    { name: "z [sd]", value: (r) => fixed(r.z, 2), sort: (r) => Math.abs(r.z), number: true },
  ], rows));
}

let later = 0;

async function draw() {
  clearTimeout(later);
  const [now, told] = await Promise.all([get(url), readAll()]);
  const model = await get(path`/v1/models/${now.model}`);
  const units = Object.fromEntries(Object.entries(model.outputs).map(([q, o]) => [q, o.unit]));
  const facts_of = Object.fromEntries(now.blades.map((b) => [b.id, b]));
  for (const r of told.items) Object.assign(r, { lot: facts_of[r.blade]?.lot ?? null, coating_lot: facts_of[r.blade]?.coating_lot ?? null });
  drawn.version = now.version;
  show($("states"), badges(statesOf(now)), told.alarms ? badge("bad", number(told.alarms, "alarm")) : null);
  notices([...warningsOf(now), told.error && ["bad", "Residuals could not be computed.", told.error],
    told.pending && ["wait", told.as_of ? "Residuals of the newest version are being computed." : "Residuals are being computed.", "A process of the role diagnose does it; this page shows them when they are there."]]);
  if (told.pending) later = setTimeout(redraw, 5000); // without alarms no event tells of them
  if (!told.as_of) {
    show($("page"), panel(null, h("p", {}, "No residuals yet.")));
    return;
  }
  show($("page"),
    panel(null, facts([
      ["Rest on", `version ${told.as_of.version}, computed ${moment(told.as_of.computed_at)}`],
      ["Visits", fixed(told.visits.length, 0)],
      ["Tests", `${told.tests.length} at ${fixed(100 * told.family_wise_error, 0)} % over all of them`],
      ["Alarms", fixed(told.alarms, 0)]])),
    panel("Each reading, predicted from the visits before it",
      h("div", { class: "controls" }, select("Colour by", Object.entries(ASKED), chosen.by, (by) => {
        chosen.by = by;
        remember({ by });
        redraw();
      })),
      told.items.length ? scatter(told.items) : h("p", {}, "No reading."),
      told.more ? h("p", { class: "small" }, `The first ${MOST} are shown.`) : null,
      aside(`The ${Math.min(LARGEST, told.items.length)} largest`, largest(told.items, units))),
    panel("Blade by visit",
      h("div", { class: "controls" }, select("Blades by", Object.entries(ORDERS), chosen.order, (order) => {
        chosen.order = order;
        remember({ order });
        redraw();
      })),
      told.items.length ? across("Residuals by blade and visit", heat(told.items, told.visits, now.blades, chosen.order)) : h("p", {}, "No reading."),
      h("p", { class: "small soft" }, "Red: read higher than predicted. Of several readings at a visit the one furthest off. A dash: not read then.")),
    panel("Tests", scroll("Tests", table(columns, told.tests, { sorted: [5, true], caption: "mean, variance and autocorrelation of groups of residuals; p among all: that by chance any of them scores as high" }))));
}

const redraw = keep(draw);
follow(names.r, redraw);
