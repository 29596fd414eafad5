// Residuals as a heat map: a column for each blade, a row for each visit, colour by z.

import { colour, s, within } from "./dom.js";
import { fixed, words } from "./format.js";
import { apart } from "./scale.js";

const REACH = 3; // sd, where the colours end
const [LEFT, RIGHT, TOP] = [92, 868, 34];
const ROW = 22;
const LEAST = 54; // from name to name, px

const css = (z) => `rgb(${apart((z + REACH) / (2 * REACH)).map(Math.round).join(", ")})`;
const people = (a, b) => String(a).localeCompare(String(b), "en", { numeric: true });

/** How blades are put in order: name -> [what is told of it, blade => its group]. */
export const ORDERS = { blade: "blade", lot: "lot", coating_lot: "coating lot", age: "age (hours at the last reading)" };

/** Blades in order, with the group that each is in; ages are numbers and make no groups. */
function inOrder(items, blades, by) {
  const facts = Object.fromEntries(blades.map((b) => [b.id, b]));
  const last = {};
  for (const r of items) last[r.blade] = Math.max(last[r.blade] ?? 0, r.time_h);
  const group = { lot: (b) => facts[b]?.lot ?? "no lot", coating_lot: (b) => facts[b]?.coating_lot ?? "no coating lot" }[by] ?? (() => "");
  const ids = Object.keys(last).sort((a, b) => people(group(a), group(b)) || (by === "age" ? last[a] - last[b] : 0) || people(a, b));
  return ids.map((id) => ({ id, group: group(id) }));
}

/** Of several readings of a blade at one visit the one furthest off is shown. */
export function heat(items, visits, blades, by) {
  const order = inOrder(items, blades, by);
  const at = {};
  for (const r of items) {
    const key = `${r.blade} ${r.visit}`;
    if (!at[key] || Math.abs(r.z) > Math.abs(at[key].z)) at[key] = r;
  }
  const starts = order.filter((b, i) => i && b.group !== order[i - 1].group).length;
  const gap = 6;
  const wide = (RIGHT - LEFT - gap * starts) / Math.max(order.length, 1);
  const bottom = TOP + ROW * visits.length;
  const text = (x, y, what, anchor = "middle", given = {}) => s("text", { x, y, "text-anchor": anchor, "font-size": 12, fill: colour("soft"), ...given }, what);
  const parts = visits.map((v, i) => text(LEFT - 8, TOP + ROW * i + 15, `${fixed(v.from_h, 0)} h`, "end"));
  let x = LEFT;
  let written = -Infinity;
  let begun = LEFT;
  order.forEach((b, i) => {
    if (i && b.group !== order[i - 1].group) x += gap;
    if (i === 0 || b.group !== order[i - 1].group) begun = x;
    visits.forEach((v, row) => {
      const r = at[`${b.id} ${v.visit}`];
      parts.push(s("rect", { x, y: TOP + ROW * row, width: Math.max(wide - (wide > 3 ? 0.6 : 0), 0.5), height: ROW - 1, fill: r ? css(r.z) : colour("hover") },
        s("title", {}, r ? `${b.id}, ${words(r.quantity)}, ${fixed(r.rotor_h, 0)} h${b.group ? `, ${b.group}` : ""}: z = ${fixed(r.z, 2)}` : `${b.id}: not read at ${fixed(v.from_h, 0)} h`)));
      if (!r) parts.push(s("line", { x1: x + wide / 4, x2: x + wide * 0.75, y1: TOP + ROW * (row + 0.5), y2: TOP + ROW * (row + 0.5), stroke: colour("soft"), "pointer-events": "none" }));
    });
    if (x - written >= LEAST) {
      parts.push(text(x + wide / 2, bottom + 14, within(b.id, Math.max(LEAST, wide) - 5, 11), "middle", { "font-size": 11 }));
      written = x;
    }
    if (b.group && (i === order.length - 1 || b.group !== order[i + 1].group)) parts.push(text((begun + x + wide) / 2, TOP - 8, within(b.group, x + wide - begun)));
    x += wide;
  });
  const scale = Array.from({ length: 61 }, (_, i) => s("rect", { x: 360 + 4 * i, y: bottom + 30, width: 4.2, height: 10, fill: css(-REACH + (i * 2 * REACH) / 60) }));
  const legend = [-REACH, 0, REACH].map((z) => text(362 + ((z + REACH) / (2 * REACH)) * 242, bottom + 56, z === 0 ? "0" : `${z < 0 ? "≤ −" : "≥ +"}${REACH}`));
  return s("svg", { class: "bars wide", viewBox: `0 0 880 ${bottom + 64}`, role: "img", "aria-label": `Residuals of ${order.length} blades at ${visits.length} visits by colour; the table below has the largest` },
    parts, scale, legend, text(352, bottom + 40, "z [sd]", "end"), text(LEFT - 8, TOP - 8, "visit", "end"));
}
