// Readings of a rotor, the newest first, a page at a time.

import { get, path } from "./api.js";
import { $, asked, h, names, panel, remember, show } from "./dom.js";
import { number } from "./format.js";
import { drawn, follow, keep } from "./live.js";
import { kindsOf, readingsTable } from "./reading.js";
import { badges, notices, statesOf, warningsOf } from "./states.js";

const rotor = names.r;
const url = path`/v1/rotors/${rotor}`;
const SIZE = 100;
const trail = [];
const chosen = { before: asked("before"), blade: asked("blade") };

const list = h("div");
const blade = h("input", { type: "text", size: 16, autocomplete: "off", value: chosen.blade ?? "" });
const newer = h("button", { type: "button", onclick: () => turn(trail.pop() ?? null) }, "Newer");
const older = h("button", { type: "button" }, "Older");

function turn(before) {
  chosen.before = before;
  remember({ before });
  redraw();
}

async function draw() {
  const now = await get(url);
  drawn.version = now.version;
  show($("states"), badges(statesOf(now)));
  notices(warningsOf(now));
  const found = await get(`${url}/inspections`, { newest: true, limit: SIZE, cursor: chosen.before, blade: chosen.blade });
  newer.disabled = chosen.before === null;
  older.disabled = found.next === null;
  older.onclick = () => {
    trail.push(chosen.before);
    turn(found.next);
  };
  show(list, found.items.length
    ? readingsTable(rotor, kindsOf(found.items).reverse(), { caption: `${number(found.items.length, "reading")} of ${number(now.head_seq, "entry", "entries")}, the newest first; late: after later hours of the same blade on this page` })
    : h("p", {}, chosen.blade ? `No reading of blade ${chosen.blade}.` : "No reading yet."));
}

show($("page"), panel(null,
  h("form", { class: "controls", onsubmit: (event) => {
    event.preventDefault();
    chosen.blade = blade.value.trim() || null;
    remember({ blade: chosen.blade });
    turn(null);
  } }, h("label", {}, "Of blade", blade), h("button", { type: "submit" }, "Show"), newer, older),
  list));
const redraw = keep(draw);
follow(rotor, redraw);
