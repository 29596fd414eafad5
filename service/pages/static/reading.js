// Readings: which kind each is, and the table of them.

import { path } from "./api.js";
import { h, scroll, table } from "./dom.js";
import { fixed, hoursAlone, inUnit, moment, number, plain, unit, words } from "./format.js";
import { badge } from "./states.js";

const KINDS = {
  counts: ["ok", "counts"], late: ["ok", "counts, late"], corrects: ["ok", "counts, corrects"],
  replaced: ["wait", "replaced"], retracted: ["warn", "retracted"],
};

/**
 * The kind of each reading, in the order of arrival. Late: it came after a reading of the same
 * blade at later hours.
 */
export function kindsOf(items) {
  const latest = new Map();
  return [...items].sort((a, b) => a.seq - b.seq).map((one) => {
    const before = latest.get(one.blade) ?? -Infinity;
    latest.set(one.blade, Math.max(before, one.time_h));
    const kind = one.status !== "counts" ? one.status : one.replaces ? "corrects" : one.time_h < before ? "late" : "counts";
    return { ...one, kind, late: one.time_h < before };
  });
}

/** What was read; of many values their number, which is no length: "1400 values in mm". */
function told(one) {
  const alone = one.values?.length === 1 && !Array.isArray(one.values[0]);
  if (alone) return inUnit(plain(one.values[0], 4), one.unit);
  return `${number(one.values?.length ?? one.count, "value")}${unit(one.unit) ? ` in ${one.unit}` : ""}`;
}

export function readingsTable(rotor, items, { blade = true, caption = null } = {}) {
  const columns = [
    { name: "Entry", value: (r) => fixed(r.seq, 0), sort: (r) => r.seq, number: true },
    { name: "Reading", value: (r) => h("span", {}, h("span", {}, r.id), r.replaces ? h("span", { class: "soft" }, ` replaces ${r.replaces}`) : null), sort: (r) => r.id, called: true },
    blade ? { name: "Blade", value: (r) => h("a", { href: path`/rotors/${rotor}/blades/${r.blade}` }, r.blade), sort: (r) => r.blade, called: true } : null,
    { name: "Quantity", value: (r) => words(r.quantity), sort: (r) => r.quantity },
    { name: "Hours [h]", value: (r) => hoursAlone(r.time_h), sort: (r) => r.time_h, number: true },
    { name: "Value", value: told, number: true },
    { name: "State", value: (r) => badge(...KINDS[r.kind]), sort: (r) => r.kind },
    { name: "Instrument", value: (r) => r.instrument ?? "–", sort: (r) => r.instrument, called: true },
    { name: "Campaign", value: (r) => r.campaign ?? "–", sort: (r) => r.campaign, called: true },
    { name: "Received", value: (r) => moment(r.received_at), sort: (r) => r.received_at },
  ].filter(Boolean);
  return scroll("Readings", table(columns, items, { caption, rowClass: (r) => (r.status === "counts" ? null : "over") }));
}
