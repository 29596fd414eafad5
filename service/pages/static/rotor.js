// A rotor at a glance: every blade by slot and as a table.

import { usual } from "./ahead.js";
import { get, offers, pages, path } from "./api.js";
import { $, asked, facts, h, names, panel, remember, scroll, select, show, table } from "./dom.js";
import { asGiven, decimals, fixed, hours, inUnit, number, percent, plain, unit, withSd, words } from "./format.js";
import { drawn, follow, keep } from "./live.js";
import { ring } from "./ring.js";
import { span } from "./scale.js";
import { since } from "./since.js";
import { badge, badges, notices, statesOf, warningsOf } from "./states.js";

const rotor = names.r;
const url = path`/v1/rotors/${rotor}`;
const chosen = { quantity: asked("quantity"), time_h: asked("time_h"), limit: asked("limit"), ahead: asked("ahead"), colour: asked("colour") ?? "mean" };
const state = h("div");
const glance = h("div");
const list = h("div");
let sorted = ["Blade", true]; // a column by its name: which ones there are changes
let model = null;
let tested = null; // what tests of the residuals told last
let shownControls = "";
const controls = h("div", { class: "controls" });

/** The component that counts: z, the radius, of a vector. */
const one = (value) => (Array.isArray(value) ? value[2] : value);

/** Which component at which node the numbers of a field are of; nothing where a quantity has none. */
function whereOf({ node, items }) {
  if (node === null) return "";
  const name = Object.keys(model.nodes).find((each) => model.nodes[each] === node);
  return `${Array.isArray(items[0]?.prediction.mean) ? ", z (radius)," : ""} at node ${node}${name ? ` (${name})` : ""}`;
}

const FEW = 0.023; // a chance: as normal, of a limit that is 2 sd off

/** What a limit says of a blade: by its chance; of one that has left, which has none, by its margin. */
function ofLimit(passed, margin) {
  if (passed === null) {
    if (margin === null || margin >= 2) return [];
    return margin < 0 ? [["bad", "beyond the limit"]] : [["warn", "limit within 2 sd"]];
  }
  if (passed < FEW) return [];
  if (passed < 0.5) return [["warn", `limit passed with ${percent(passed)}`]];
  return [["bad", margin !== null && margin < 0 ? `beyond the limit (${percent(passed)})` : `limit passed with ${percent(passed)}`]];
}

/** The limit that was given; null: none was. */
const limitOf = () => (chosen.limit && Number.isFinite(Number(chosen.limit)) ? Number(chosen.limit) : null);

/** Hours from now on by which blades are to pass it, of whatever age; null: by the hour of the table. */
const aheadOf = () => (limitOf() !== null && chosen.ahead && Number.isFinite(Number(chosen.ahead)) ? Number(chosen.ahead) : null);

/** Which blades pass the limit by the hour, and how surely any does; null: none was given. */
async function lifeOf(time_h) {
  const limit = limitOf();
  if (limit === null) return null;
  const ahead = aheadOf();
  const given = new URLSearchParams({ limit, ...(ahead === null ? { times: time_h } : { ahead }) });
  if (chosen.quantity) given.set("quantity", chosen.quantity);
  return get(`${url}/life?${given}`); // a limit of ours, not a page's length
}

function judged(found, health, life) {
  const limit = limitOf();
  const lives = new Map((life?.blades ?? []).map((b) => [b.id, b]));
  const contradicted = new Set((health?.contradicted ?? []).map((c) => c.blade ?? c));
  const exchanged = new Set((health?.exchanged ?? []).flatMap((e) => e.blades));
  return found.items.map((blade) => {
    const mean = one(blade.prediction.mean);
    const sd = one(blade.prediction.sd.blade);
    const own = lives.get(blade.id);
    const margin = limit === null || life.ahead || !(sd > 0) ? null : (limit - mean) / sd; // of the table's hour
    const passed = own?.passed[0] ?? null;
    const age = own?.age_h ?? null;
    const alarms = [];
    if (contradicted.has(blade.id)) alarms.push(["bad", "contradicts the rotor"]);
    if (exchanged.has(blade.id)) alarms.push(["bad", "readings look exchanged"]);
    alarms.push(...ofLimit(passed, margin));
    const held = blade.prediction.held_from_h;
    if (held !== null && held <= found.time_h) alarms.push(["warn", `too little of an effect from ${hours(held)} on`]);
    if (own?.age_by === "reading") alarms.push(["wait", "age as of its last reading"]);
    if (blade.retired) alarms.push(["wait", "retired"]);
    if (blade.readings.counting === 0) alarms.push(["wait", "no readings: what the rotor tells"]);
    return { ...blade, mean, sd, margin, passed, age, alarms };
  });
}

const SIGN = { bad: "✕", warn: "▲" };
const signOf = (blade) => SIGN[blade.alarms[0]?.[0]] ?? null;
const GRAVE = { bad: 0, warn: 1, wait: 2 };

function coloured(blades, found) {
  const ways = {
    mean: ["mean at that hour", (b) => b.mean, found.unit],
    sd: ["sd at that hour", (b) => b.sd, found.unit],
    readings: ["readings that count", (b) => b.readings.counting, ""],
    margin: ["margin to the limit", (b) => (b.margin === null ? null : Math.min(b.margin, 10)), "sd"],
    chance: ["chance past the limit", (b) => (b.passed === null ? null : 100 * b.passed), "%"],
  };
  const without = limitOf() === null ? ["margin", "chance"] : aheadOf() === null ? [] : ["margin"];
  const asked = without.includes(chosen.colour) ? "mean" : chosen.colour;
  const [what, value, unitName] = ways[asked] ?? ways.mean;
  const numbers = blades.map(value).filter((v) => v !== null);
  return { what, value, unitName, span: span(numbers) };
}

function drawControls(found) {
  const text = JSON.stringify([model.id, chosen.quantity]);
  if (text === shownControls) return;
  shownControls = text;
  const field = (name, label, after, value) => h("label", {}, label,
    h("input", { type: "number", step: "any", min: 0, value, onchange: (event) => change({ [name]: event.target.value || null }) }), after);
  const quantities = Object.keys(model.outputs);
  show(controls,
    select("Quantity", quantities.map((q) => [q, words(q)]), found.quantity, (q) => change({ quantity: q, limit: null })),
    field("time_h", "at", "h", found.time_h),
    field("limit", "Limit", unit(found.unit), chosen.limit ?? ""),
    field("ahead", "passed within", "h from now on", chosen.ahead ?? ""),
    select("Colour", [["mean", "mean"], ["sd", "sd"], ["readings", "readings"], ["margin", "margin (needs a limit)"], ["chance", "chance (needs a limit)"]], chosen.colour, (c) => change({ colour: c })));
}

function change(given) {
  Object.assign(chosen, given);
  remember(given);
  if ("quantity" in given) shownControls = "";
  redraw();
}

/** The rotor's own line: its blades share parameters, and their chances do not multiply. */
const together = (life) =>
  h("p", {}, `${life.ahead ? `Within ${hours(life.time_h[0])} from now on` : `By ${hours(life.time_h[0])} of each blade’s own operation`}: ${fixed(life.expected[0], 1)} blades expected past ${inUnit(asGiven(life.limit), life.unit)}; at least one with ${percent(life.any[0])}.`);

function drawBlades(found, blades, life) {
  const places = decimals(Math.min(...blades.map((b) => b.sd).filter((v) => v > 0), Infinity), 2);
  const means = Number.isFinite(places) && places > 0 ? places : 3;
  const tell = (b) => `blade ${b.id}${b.slot ? `, slot ${b.slot}` : ""}: ${inUnit(withSd(b.mean, b.sd), found.unit)}, ${number(b.readings.counting, "reading")}${b.alarms.map((a) => `, ${a[1]}`).join("")}`;
  const inPlace = blades.filter((b) => !b.retired);
  show(glance, ring(rotor, inPlace.length ? inPlace : blades, { ...coloured(blades, found), tell, sign: signOf }),
    h("p", { class: "small soft" }, "A blade's colour is its ", coloured(blades, found).what, ". ✕ and ▲ outside the ring: alarms. The table beside holds the same numbers."));
  const columns = [
    { name: "Blade", value: (b) => h("a", { href: path`/rotors/${rotor}/blades/${b.id}` }, b.id), sort: (b) => b.id, called: true },
    { name: "Slot", value: (b) => b.slot ?? "–", sort: (b) => b.slot, called: true },
    { name: "State", value: (b) => (b.alarms.length ? h("span", { class: "states" }, b.alarms.map(([kind, text]) => badge(kind, text))) : badge("ok", "no alarm")), sort: (b) => GRAVE[b.alarms[0]?.[0]] ?? 3 },
    { name: `Mean${unit(found.unit) ? ` [${unit(found.unit)}]` : ""}`, value: (b) => fixed(b.mean, means), sort: (b) => b.mean, number: true },
    { name: "±\u00a0sd", value: (b) => fixed(b.sd, means), sort: (b) => b.sd, number: true },
    life?.ahead ? { name: "Age", value: (b) => hours(b.age), sort: (b) => b.age, number: true } : null,
    life && !life.ahead ? { name: "Margin [sd]", value: (b) => plain(b.margin, 2), sort: (b) => b.margin, number: true } : null,
    life ? { name: "Chance past the limit", value: (b) => percent(b.passed), sort: (b) => b.passed, number: true } : null,
    { name: "Readings", value: (b) => `${b.readings.counting}${b.readings.overruled ? ` (+${b.readings.overruled} void)` : ""}`, sort: (b) => b.readings.counting, number: true },
    { name: "Posted last, at", value: (b) => hours(b.readings.last?.time_h), sort: (b) => b.readings.last?.time_h, number: true },
    { name: "Received", value: (b) => (b.readings.last ? since(b.readings.last.received_at) : "never"), sort: (b) => b.readings.last?.received_at },
    blades.some((b) => b.lot) ? { name: "Lot", value: (b) => b.lot ?? "–", sort: (b) => b.lot, called: true } : null,
  ].filter(Boolean);
  const made = table(columns, blades, {
    caption: `Predicted ${words(found.quantity)}${whereOf(found)} at ${hours(found.time_h)} of each blade's own operation; sd of the blade itself, without a reading's noise`,
    sorted: [Math.max(0, columns.findIndex((c) => c.name === sorted[0])), sorted[1]] });
  made.addEventListener("sorted", (event) => { sorted = [columns[event.detail[0]].name, event.detail[1]]; });
  show(list, life ? together(life) : null, scroll("Blades", made));
}

/** Whether tests of the residuals alarm: no blade's state says it. */
function alarming(told) {
  if (!told?.as_of) return null;
  const link = h("a", { href: path`/rotors/${rotor}/residuals` }, told.alarms ? badge("bad", number(told.alarms, "alarm")) : "no alarm");
  return ["Residuals", h("span", {}, link, told.pending ? ` of version ${told.as_of.version}` : "")];
}

function drawState(rotorNow) {
  const posterior = rotorNow.posterior;
  show(state, facts([
    ["Version", posterior ? `${posterior.version}, through entry ${posterior.through_seq} of ${rotorNow.head_seq}` : "none yet"],
    posterior && ["Computed", since(posterior.created_at)],
    ["Backlog", number(rotorNow.head_seq - rotorNow.applied_seq, "entry", "entries")],
    ["Health", rotorNow.health ? `${rotorNow.health.status}${rotorNow.health.ess ? `, ${fixed(rotorNow.health.ess, 0)} effective nodes` : ""}` : "–"],
    alarming(tested),
    rotorNow.effects?.length > 0 && ["Adopted", h("span", {}, rotorNow.effects.flatMap((e, i) => [i ? "; " : "", e.name, ", ", since(e.at), e.unasked ? ", by the rotor itself" : "", e.chosen ? `, chosen: ${e.chosen.because}` : ""]))],
    ["Model", h("a", { href: path`/models/${rotorNow.model}` }, `${rotorNow.model} ${rotorNow.model_version.slice(0, 8)}`)],
    ["Blades", `${rotorNow.blades.filter((b) => !b.retired).length} in place, ${rotorNow.blades.filter((b) => b.retired).length} retired`],
  ]));
}

const residuals = h("span");
async function draw() {
  const now = await get(url);
  drawn.version = now.version;
  show($("states"), badges(statesOf(now)));
  drawState(now);
  notices(warningsOf(now));
  model ??= await get(path`/v1/models/${now.model}`);
  if (now.version === 0) {
    show(glance, h("p", { class: "wait" }, "No posterior yet."));
    show(list, h("p", { class: "wait" }, `${number(now.blades.length, "blade")}; their predictions come with the first posterior.`));
    return;
  }
  if (now.blades.length === 0) {
    show(glance, h("p", {}, "No blade yet."));
    show(list, h("p", {}, `No blade yet: POST ${url}/blades lets one join.`));
    return;
  }
  const tests = get(`${url}/residuals`, { limit: 1 }).catch(() => null);
  const quantity = chosen.quantity;
  const time_h = chosen.time_h ?? usual(model);
  const passing = lifeOf(time_h);
  passing.catch(() => {}); // what went wrong is told where it is waited for
  const first = await get(`${url}/blades`, { quantity, time_h, limit: 200 });
  if (first.next !== null) {
    const rest = await pages(`${url}/blades`, { quantity, time_h, cursor: first.next }, 2000);
    first.items.push(...rest.items);
  }
  drawControls(first);
  const life = await passing;
  drawBlades(first, judged(first, now.health, life), life);
  tested = await tests;
  drawState(now);
}

show($("page"),
  h("div", { class: "columns ring-left" },
    h("div", { class: "stack" }, panel("Blades by slot", glance), panel("State", state, residuals)),
    panel("Blades", controls, list)));
const redraw = keep(draw);
follow(rotor, redraw);
offers("post", "/v1/rotors/{r}/diagnoses").then((there) => {
  if (there) show(residuals, h("p", {}, h("a", { href: path`/rotors/${rotor}/diagnoses` }, "Does the model lack something? Diagnoses")));
}).catch(() => {});
