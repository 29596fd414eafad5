// One diagnosis: how far it is, what was found, what was tried, before and after.

import { Problem, ask, get, offers, pages, path, post, remove } from "./api.js";
import { $, across, aside, colour, facts, h, names, panel, s, scroll, show, table } from "./dom.js";
import { axis, fixed, hours, inUnit, moment, number, plain, withSd, words } from "./format.js";
import { drawn, follow, keep } from "./live.js";
import { pictures } from "./pictures.js";
import { progress } from "./progress.js";
import { effectsOf, isInForce, isWider, standing } from "./standing.js";
import { badge, notices, shaken } from "./states.js";
import { askedBy, stateOf, verdictOf } from "./verdict.js";

const rotor = path`/v1/rotors/${names.r}`;
const url = path`/v1/rotors/${names.r}/diagnoses/${names.d}`;
const TEMPLATE = "/v1/rotors/{r}/diagnoses/{d}";
const said = h("p", { role: "status", class: "small" });
const MOST = 40;

async function act(what, how) {
  try {
    await how();
    said.textContent = `${what}: done.`;
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    said.textContent = `${what}: ${error.message}`;
  }
  redraw();
}

/** The report as a file: the request carries the key, which a link would not. */
async function report() {
  const answer = await ask("GET", `${url}/report`);
  const link = h("a", { href: URL.createObjectURL(await answer.blob()), download: `diagnosis-${names.r}-${names.d}.html` });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

/** Evidence of what was tried as bars, the weightiest first. */
function ranking(tried) {
  const rows = tried.filter((t) => t.log_bf !== null).sort((a, b) => b.log_bf - a.log_bf).slice(0, 12);
  if (rows.length === 0) return null;
  const top = Math.max(...rows.map((r) => r.log_bf), 1);
  const least = Math.min(...rows.map((r) => r.log_bf), 0);
  const X = (v) => 300 + ((v - least) / (top - least)) * 270;
  const height = 22 * rows.length + 24;
  return s("svg", { class: "bars", viewBox: `0 0 620 ${height}`, role: "img", "aria-label": "Log Bayes factor of what was tried; the table below has the numbers" },
    rows.map((row, i) => [
      s("text", { x: 292, y: 22 * i + 15, "text-anchor": "end", "font-size": 12, fill: colour("ink") }, words(row.what).length > 48 ? `${words(row.what).slice(0, 47)}…` : words(row.what)),
      s("rect", { x: Math.min(X(0), X(row.log_bf)), y: 22 * i + 4, width: Math.max(1, Math.abs(X(row.log_bf) - X(0))), height: 14, fill: colour(row.log_bf >= 0 ? "parameters" : "over") }),
      s("text", { x: Math.max(X(0), X(row.log_bf)) + 5, y: 22 * i + 15, "font-size": 11, fill: colour("soft") }, fixed(row.log_bf, 1))]),
    s("text", { x: 440, y: height - 4, "text-anchor": "middle", "font-size": 11, fill: colour("soft") }, "log Bayes factor [nat]"));
}

function beforeAfter(told, unitName, wider) {
  if (!told) return h("p", { class: "soft" }, "No comparison: it was not asked for, or no effect is claimed.");
  const share = (v) => `${fixed(100 * v, 0)} %`;
  const rows = [
    ["count", "readings", (v) => fixed(v, 0)], ["rmse", axis("root mean square error", unitName), plain],
    ["bias", axis("bias: predicted less measured", unitName), plain], ["log_score", "log score [nat per reading]", plain],
    ["within_68", "inside the 68 % band", share], ["within_95", "inside the 95 % band", share], ["width", axis("width of the 95 % band", unitName), plain],
  ].map(([name, text, form]) => ({ name: text, before: told.before?.[name], after: told.after?.[name], form })).filter((r) => typeof r.before === "number");
  const { forecast } = told;
  if (forecast) {
    const ahead = (one) => (one.mean === null ? "–" : withSd(one.mean, one.sd));
    rows.push({ name: axis(`forecast: blades' mean at ${hours(forecast.time_h)}, ± sd of a single blade`, unitName), before: forecast.before, after: forecast.after, form: ahead });
  }
  return [scroll("Before and after", table([
    { name: "On readings that neither used", value: (r) => r.name },
    { name: "Before", value: (r) => r.form(r.before), number: true },
    { name: "After", value: (r) => r.form(r.after), number: true },
  ], rows)), wider ? h("p", { class: "small" }, "After is the model with a discrepancy that names no cause, here and of shared parameters.") : null, aside(`The ${told.held_out.length} readings of ${words(told.quantity)} that neither used`, h("p", { class: "small" }, `The latest third of every second blade's: ${told.held_out.join(", ")}`))];
}

/** Whether each effect's amplitude holds, between halves of the blades and early and late. */
function halves(holds) {
  if (!holds.length) return null;
  const gains = (one) => (one.gained_nat ? one.gained_nat.map((nat) => fixed(nat, 1)).join(" and ") : "–");
  return aside("Does it hold between halves", scroll("Does it hold between halves", table([
    { name: "Effect", value: (one) => one.effect },
    { name: "Between", value: (one) => one.by },
    { name: "Expected sizes", value: (one) => one.amplitudes.map((a) => plain(a)).join(" and "), number: true },
    { name: "± sd apart", value: (one) => plain(one.sd), number: true },
    { name: "Alone [nat]", value: gains, number: true },
    { name: "Agree", value: (one) => (one.agrees ? "yes" : "no") },
  ], holds)));
}

/** Where nothing was found: from which size on an effect would have been. */
function unseen(told) {
  if (!told?.families.length) return null;
  const size = (value, which, one) => (value === null ? "–" : inUnit(plain(value, 2), one.unit) + (which && plain(one.least, 2) !== plain(one.most, 2) ? ` (${which})` : ""));
  return panel("What would have been noticed", scroll("What would have been noticed", table([
    { name: "Effect", value: (one) => one.family },
    { name: "Of", value: (one) => (one.whom === "all" ? "all blades" : `one ${words(one.whom)}`) },
    { name: "From", value: (one) => size(one.least, one.easiest, one), number: true },
    { name: "At worst from", value: (one) => size(one.most, one.hardest, one), number: true },
    { name: "Amplitude", value: (one) => words(one.of) },
  ], told.families)), h("p", { class: "small" }, `Sizes that would have raised the alarm with a probability of ${fixed(100 * told.probability, 0)} %, each by itself; –: it would have to be larger than is looked for. Effects of single blades are not told.`));
}

function result(found, unitName) {
  const units = Object.fromEntries((found.pictures?.amplitudes ?? []).map((one) => [one.name, one.unit]));
  const effects = found.effects.length ? scroll("Effects", table([
    { name: "Effect", value: (e) => e.name ?? words(e.words) },
    { name: "What happens", value: (e) => e.words ?? "–" },
    { name: "Amplitude", value: (e) => inUnit(withSd(e.amplitude.mean, e.amplitude.sd), e.amplitude.unit ?? units[e.name]), number: true },
    { name: "Of", value: (e) => words(e.amplitude.of ?? "–") },
  ], found.effects)) : h("p", { class: "soft" }, "No effect is named.");
  const shared = Object.keys(found.parameters.before).map((name) => ({ name, before: found.parameters.before[name], after: found.parameters.after[name] }));
  const pair = (p) => (p && typeof p === "object" && "mean" in p ? withSd(p.mean, p.sd) : p === undefined ? "–" : JSON.stringify(p));
  const bars = ranking(found.tried);
  return [
    panel("Verdict", h("p", {}, verdictOf(found.verdict)), found.reasons.map((reason) => h("p", {}, reason)), facts([
      ["Chance under the model alone", found.p === null ? "–" : (found.p * (found.dealt + 1) < 1.5 ? "≤ " : "") + plain(found.p, 2)],
      ["The same with the effects", found.p_after === null ? "–" : plain(found.p_after, 2)],
      ["Gain in evidence", found.gained_nat === null ? "–" : `${fixed(found.gained_nat, 1)} nat${found.claimed || !found.effects.length ? "" : ", by what is not claimed"}`],
      ["Readings", `${found.readings.used} used of ${found.readings.delivered}`],
      ["Rests on", `entries to ${found.rests_on.through_seq}, model ${found.rests_on.model} ${found.rests_on.model_version.slice(0, 8)}`],
    ])),
    panel(found.claimed || !found.effects.length ? "Effects" : "Effects that were calibrated, not claimed", effects),
    panel("Before and after", beforeAfter(found.before_after, unitName, isWider(found)),
      shared.length ? scroll("Shared parameters", table([
        { name: "Shared parameter", value: (p) => words(p.name) },
        ...(found.names.length || isWider(found) ? [
          { name: "Before", value: (p) => pair(p.before), number: true },
          { name: "After", value: (p) => pair(p.after), number: true },
        ] : [{ name: "Mean ± sd", value: (p) => pair(p.before), number: true }]),
      ], shared)) : null),
    unseen(found.noticed),
    panel("What was tried", bars ? across("Evidence of what was tried", bars) : h("p", { class: "soft" }, "Nothing had to be tried."),
      found.tried.length ? aside(`The first ${Math.min(MOST, found.tried.length)} of ${found.tried.length} as a table`, scroll("Tried", table([
        { name: "Effect", value: (t) => words(t.what) },
        { name: "Log Bayes factor [nat]", value: (t) => fixed(t.log_bf, 2), sort: (t) => t.log_bf, number: true },
      ], found.tried.slice(0, MOST)))) : null,
      found.no_room.length ? h("p", { class: "small" }, `No room for: ${found.no_room.map((n) => `${n.names.join(" + ")} (${n.why})`).join("; ")}`) : null,
      halves(found.holds),
      found.placebos?.length ? aside("Placebos: the same effect where it is not", scroll("Placebos", table([
        { name: "Effect", value: (one) => one.effect },
        { name: "Given to", value: (one) => one.by },
        { name: "Gain as much", value: (one) => `${one.won} of ${one.count}`, number: true },
        { name: "Effect [nat]", value: (one) => fixed(one.gained_nat, 1), number: true },
        { name: "Best placebo [nat]", value: (one) => fixed(one.best_nat, 1), number: true },
      ], found.placebos))) : null,
      found.concerns?.length ? aside("Do all blades have it", scroll("Do all blades have it", table([
        { name: "Effect", value: (c) => c.effect },
        { name: "Blades", value: (c) => String(c.blades), sort: (c) => c.blades, number: true },
        { name: "All have it [%]", value: (c) => fixed(100 * c.all, 1), sort: (c) => c.all, number: true },
        { name: "If some: of them [%]", value: (c) => fixed(100 * c.share, 0), sort: (c) => c.share, number: true },
        { name: "Some against all [nat]", value: (c) => fixed(c.some_nat, 1), sort: (c) => c.some_nat, number: true },
      ], found.concerns))) : null),
  ];
}

/** The report's pictures, or why there are none. */
async function drawings(can) {
  if (!can) return null;
  try {
    return await pictures(url);
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    return panel("Pictures", h("p", { class: "soft" }, error.message));
  }
}

/** Which of the alternatives somebody knows it to be, where none is claimed: a button each. */
function choices(told, choose) {
  const called = (one) => one.effects.map((e) => `${e.name}, ${e.step_h === null ? e.shape : `at ${hours(e.step_h)}`}`).join(" and ");
  return panel("Known from elsewhere", h("p", {}, "The readings do not tell these apart. Who knows which it is, by a borescope, say, or a workshop's report, may adopt it; the log keeps who chose, and why."),
    scroll("Alternatives", table([
      { name: "Number", value: (one) => String(one.number), number: true },
      { name: "Effects", value: called },
      { name: "Amplitude", value: (one) => one.adoption.effects.map(({ amplitude: a }) => inUnit(withSd(a.mean, a.sd), a.unit)).join(" and "), number: true },
      { name: "Share of the evidence [%]", value: (one) => fixed(100 * one.share, 0), sort: (one) => one.share, number: true },
      { name: "", value: (one) => h("button", { type: "button", onclick: () => choose(one, called(one)) }, `Adopt ${one.number}`) },
    ], told.each)));
}

/** A reason is asked for; without one nothing happens. */
function choose(one, name) {
  const because = prompt(`Put ${name} into this rotor's model? From where is it known?`)?.trim();
  if (because) act(`Adopt ${one.number}`, () => post(`${url}/adoption`, { alternative: one.number, because }));
}

const button = (text, how, quiet) => h("button", { type: "button", class: quiet ? null : "main", onclick: how }, text);
const backOut = (what) => button("Back out", () => confirm(`Take the ${what} out of this rotor's model again?`) && act("Back out", () => remove(`${url}/adoption`)), true);

/** The diagnosis; where it is not here, the problem that says so. */
async function here() {
  try {
    return await get(url);
  } catch (error) {
    if (error.status !== 404) throw error;
    return error;
  }
}

/** What a rotor brought with it of a diagnosis that stayed where it was made (an import). */
function away(history, now, canBackOut) {
  show($("states"), badge("warn", "not here"));
  notices([["warn", "This diagnosis did not travel with its rotor: what it found, and its report, stayed where they were made.", "What it put into the model came with the rotor’s log."],
    ...shaken(now.effects.filter((one) => one.diagnosis === names.d))]);
  const actions = h("div", { class: "controls actions" }, canBackOut && isInForce(history) ? backOut("effect") : null, said);
  show($("page"), panel("In the model", standing(history, now, {}), actions), panel("Effects", effectsOf(history)));
}

let next = 0;

async function draw() {
  const [d, canReport, canAdopt, canBackOut, canCancel] = await Promise.all([here(),
    offers("get", `${TEMPLATE}/report`), offers("post", `${TEMPLATE}/adoption`), offers("delete", `${TEMPLATE}/adoption`), offers("delete", TEMPLATE)]);
  const [now, adoptions] = await Promise.all([get(rotor), pages(`${rotor}/adoptions`)]);
  drawn.version = now.version;
  const history = adoptions.items.filter((one) => one.diagnosis === names.d);
  if (d instanceof Problem) {
    if (history.length === 0) throw d;
    away(history, now, canBackOut);
    return;
  }
  const inForce = isInForce(history);
  const going = d.status === "queued" || d.status === "running";
  show($("states"), badge(...stateOf(d)));
  notices([d.status === "failed" && ["bad", `It failed after ${number(d.attempts, "attempt")}.`, d.error],
    d.status === "cancelled" && ["warn", "It was cancelled: there is no result."],
    ...shaken(now.effects.filter((one) => one.diagnosis === names.d))]);
  const done = d.status === "done";
  const wider = done && isWider(d.result);
  const adoptable = wider || (done && d.result.claimed);
  const choosable = done && !d.result.claimed && d.result.alternatives?.each[0].adoption !== undefined;
  const what = wider ? "discrepancy, which names no cause," : "effect";
  const model = done ? await get(path`/v1/models/${d.result.rests_on.model}`) : null;
  const unitName = model?.outputs[d.result.before_after?.quantity]?.unit ?? "";
  show($("page"),
    panel(null, facts([["Asked", moment(d.created_at)], ["By", askedBy(d.request)], ["Ended", moment(d.finished_at)], ["Rests on", `entries to ${d.request.through_seq}`],
      going && ["Progress", d.status === "queued" ? "queued: it begins when a worker with the role diagnose is free" : progress(d.progress)]]),
    h("div", { class: "controls actions" },
      going && canCancel ? button("Cancel", () => act("Cancel", () => remove(url)), true) : null,
      done && canReport ? button("Save the report", () => act("Report", report), true) : null,
      adoptable && canAdopt && !inForce ? button("Adopt into the model", () => confirm(`Put the ${what} into this rotor's model?`) && act("Adopt", () => post(`${url}/adoption`))) : null,
      (adoptable || choosable) && canBackOut && inForce ? backOut(what) : null), said),
    choosable && canAdopt && !inForce ? choices(d.result.alternatives, choose) : null,
    adoptable || history.length ? panel("In the model", standing(history, now, d.result)) : null,
    done ? h("div", { class: "columns halves" }, result(d.result, unitName), await drawings(canReport)) : null);
  clearTimeout(next);
  if (going) next = setTimeout(redraw, 1000);
}

const redraw = keep(draw);
follow(names.r, redraw);
