// Diagnoses of a rotor: what it lacks was asked for, and is asked for here.

import { Problem, get, offers, path, post } from "./api.js";
import { $, h, names, panel, scroll, select, show, table } from "./dom.js";
import { fixed } from "./format.js";
import { changes, keep } from "./live.js";
import { progress } from "./progress.js";
import { since } from "./since.js";
import { badge, badges, notices, statesOf, warningsOf } from "./states.js";
import { stateOf, verdictOf } from "./verdict.js";

const rotor = names.r;
const url = path`/v1/rotors/${rotor}/diagnoses`;
const list = h("div");
const itself = h("form", { class: "controls", onsubmit: decide });
const said = h("p", { role: "status", class: "small" });
const compare = h("input", { type: "checkbox", checked: true, id: "compare" });
const begin = h("button", { type: "submit", class: "main" }, "Look for what the model lacks");

async function start(event) {
  event.preventDefault();
  begin.disabled = true;
  try {
    const { diagnosis } = await post(url, { compare: compare.checked });
    location.href = path`/rotors/${rotor}/diagnoses/${diagnosis.id}`;
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    said.textContent = error.message;
    begin.disabled = false;
  }
}

const ASKS = [["never", "never"], ["alarm", "where residuals alarm"], ["readings", "there, and as readings come"]];
const ADOPTS = [["never", "nothing by itself"], ["effect", "an effect that is named"]];
const decided = h("p", { role: "status", class: "small" });
let stands = {};
let wanted = {};

async function decide(event) {
  event.preventDefault();
  try {
    await post(path`/v1/rotors/${rotor}/policy`, wanted);
    decided.textContent = "Decided.";
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    decided.textContent = error.message;
  }
  stands = {};
  redraw();
}

// Drawn where the service says something new alone: a choice that is being made stays.
async function policy(now) {
  if (now.diagnose === stands.diagnose && now.adopt === stands.adopt) return;
  stands = { diagnose: now.diagnose, adopt: now.adopt };
  wanted = { ...stands };
  const there = await offers("post", "/v1/rotors/{r}/policy").catch(() => false);
  const button = h("button", { type: "submit", disabled: true }, "Decide");
  const change = (more) => {
    wanted = { ...wanted, ...more };
    button.disabled = !there || (wanted.diagnose === stands.diagnose && wanted.adopt === stands.adopt);
  };
  show(itself,
    select("It asks", ASKS, stands.diagnose, (diagnose) => change({ diagnose })),
    select("and adopts", ADOPTS, stands.adopt, (adopt) => change({ adopt })), button);
  itself.querySelectorAll("select").forEach((one) => { one.disabled = !there; });
}

let inForce = new Set();

/** Whether what a diagnosis found is in the model, or the rotor was to adopt it and did not: why stands on its page. */
function inModel(d) {
  if (inForce.has(d.id)) return badge("ok", "adopted");
  return d.not_adopted ? badge("warn", "not adopted by itself", d.not_adopted) : "–";
}

const columns = [
  { name: "Asked", value: (d) => h("a", { href: path`/rotors/${rotor}/diagnoses/${d.id}` }, since(d.created_at)), sort: (d) => d.created_at },
  { name: "By", value: (d) => (d.request.because ? (d.request.because.alarms ? "residuals" : "readings") : "somebody"), sort: (d) => (d.request.because ? 1 : 0) },
  { name: "State", value: (d) => badge(...stateOf(d)), sort: (d) => d.status },
  { name: "Verdict", value: (d) => (d.verdict ? verdictOf(d.verdict) : d.status === "running" ? progress(d.progress) : "–"), sort: (d) => d.verdict },
  { name: "Effects", value: (d) => d.names?.join(", ") || "–" },
  { name: "In the model", value: inModel, sort: (d) => (inForce.has(d.id) ? 2 : d.not_adopted ? 1 : 0) },
  { name: "Rests on entries to", value: (d) => fixed(d.request.through_seq, 0), sort: (d) => d.request.through_seq, number: true },
];

let cursor = null;
const news = changes();
const older = h("button", { type: "button" }, "Older");
async function draw() {
  const now = await get(path`/v1/rotors/${rotor}`);
  show($("states"), badges(statesOf(now)));
  notices(warningsOf(now));
  await policy(now);
  const found = await get(url, { limit: 50, cursor });
  older.hidden = found.next === null;
  older.onclick = () => {
    cursor = found.next;
    redraw();
  };
  inForce = new Set(now.effects.map((one) => one.diagnosis));
  if (!news([found, ...inForce])) return;
  show(list, found.items.length
    ? scroll("Diagnoses", table(columns, found.items, { caption: "The newest first" }))
    : h("p", { class: "soft" }, "None was asked for yet."));
}

show($("page"),
  panel("Ask", h("form", { class: "controls", onsubmit: start }, begin, h("label", { for: "compare" }, compare, "compare before and after on readings that neither model used")),
    h("p", { class: "soft small" }, "It takes minutes and rests on the readings that count now. Rotor and model stay as they are until what it names is adopted."), said),
  panel("What the rotor does by itself", itself, h("p", { class: "soft small" }, "What was adopted stays until somebody backs it out. A diagnosis under way is judged, when it ends, by what is decided then."), decided),
  panel("Diagnoses", list, older));
const redraw = keep(draw, { everyS: 3 });
offers("post", "/v1/rotors/{r}/diagnoses").then((there) => { begin.disabled = !there; }).catch(() => {});
