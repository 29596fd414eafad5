// All rotors, a page at a time.

import { get, path } from "./api.js";
import { $, asked, h, panel, remember, scroll, show, table } from "./dom.js";
import { fixed, moment, number } from "./format.js";
import { changes, keep } from "./live.js";
import { badges, notices, statesOf } from "./states.js";

const SIZE = 50;
const trail = [];
let cursor = asked("after");

const columns = [
  { name: "Rotor", value: (r) => h("a", { href: path`/rotors/${r.id}` }, r.id), sort: (r) => r.id, called: true },
  { name: "State", value: (r) => h("span", { class: "states" }, badges(statesOf({ ...r, posterior: r.sealed === null ? null : { sealed: r.sealed } }))), sort: (r) => r.status },
  { name: "Model", value: (r) => `${r.model} ${r.model_version.slice(0, 8)}`, sort: (r) => r.model },
  { name: "Log", value: (r) => fixed(r.head_seq, 0), sort: (r) => r.head_seq, number: true },
  { name: "Not applied", value: (r) => fixed(r.head_seq - r.applied_seq, 0), sort: (r) => r.head_seq - r.applied_seq, number: true },
  { name: "Version", value: (r) => (r.version ? fixed(r.version, 0) : "none yet"), sort: (r) => r.version, number: true },
  { name: "Particles", value: (r) => fixed(r.particles, 0), sort: (r) => r.particles, number: true },
  { name: "Created", value: (r) => moment(r.created_at), sort: (r) => r.created_at },
];

const list = h("div");
const jump = h("input", { type: "text", size: 20, autocomplete: "off" });
const before = h("button", { type: "button", onclick: () => turn(trail.pop() ?? null) }, "Previous");
const after = h("button", { type: "button" }, "Next");
const form = h("form", { class: "controls", onsubmit: (event) => {
  event.preventDefault();
  trail.push(cursor);
  turn(justBefore(jump.value.trim()));
} }, h("label", {}, "Names from", jump), h("button", { type: "submit" }, "Show"), before, after);

// What names are made of, in the order of the list.
const SIGNS = "+-.0123456789:@ABCDEFGHIJKLMNOPQRSTUVWXYZ_abcdefghijklmnopqrstuvwxyz";

/** A name below every one that begins with `text`, and above nearly all that come before it. */
const justBefore = (text) => {
  if (!text) return null;
  const last = SIGNS.indexOf(text.at(-1));
  const before = last > 0 ? `${text.slice(0, -1)}${SIGNS[last - 1]}zzzz` : text.slice(0, -1);
  return /^[A-Za-z0-9]/.test(before) ? before : null;
};

let sorted = [0, true];
const news = changes();
async function draw() {
  const found = await get("/v1/rotors", { limit: SIZE, cursor });
  notices([]);
  after.onclick = () => {
    trail.push(cursor);
    turn(found.next);
  };
  after.disabled = found.next === null;
  before.disabled = cursor === null;
  if (!news([cursor, found])) return;
  if (found.items.length === 0) {
    show(list, cursor === null
      ? h("p", {}, "No rotor is there yet, or none for this key. POST /v1/rotors creates one.")
      : h("p", {}, "No rotor comes after that name."));
    return;
  }
  const made = table(columns, found.items, { caption: `${number(found.items.length, "rotor")} on this page, by name`, sorted });
  made.addEventListener("sorted", (event) => { sorted = event.detail; });
  show(list, scroll("Rotors", made));
}

function turn(to) {
  cursor = to;
  remember({ after: to });
  redraw();
}

show($("page"), panel(null, form, list));
const redraw = keep(draw, { everyS: 10 });
