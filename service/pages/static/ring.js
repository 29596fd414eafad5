// The rotor from the front: a ring of slots, each a link to its blade.

import { path } from "./api.js";
import { s, within } from "./dom.js";
import { labels, unit } from "./format.js";
import { css, dark, share, ticks } from "./scale.js";

const R0 = 128;
const R1 = 186;

/** How wide a label of one of so many sectors may be, whichever way it lies. */
const room = (count) => Math.min(R1 - R0, (Math.PI * (R0 + R1)) / count) - 3;

function sector(from, to) {
  const at = (r, a) => `${(r * Math.sin(a)).toFixed(2)} ${(-r * Math.cos(a)).toFixed(2)}`;
  const large = to - from > Math.PI ? 1 : 0;
  return `M${at(R0, from)} L${at(R1, from)} A${R1} ${R1} 0 ${large} 1 ${at(R1, to)} L${at(R0, to)} A${R0} ${R0} 0 ${large} 0 ${at(R0, from)} Z`;
}

/** The slot of each blade: its number where all have one of their own, counted from 1 or from 0, else their order. */
export function slots(blades) {
  const given = blades.map((blade) => (/^\d+$/.test(blade.slot ?? "") ? Number(blade.slot) : null));
  const fit = given.every((n) => n !== null && n <= 400) && new Set(given).size === given.length;
  const first = given.includes(0) ? 0 : 1;
  return {
    count: fit ? Math.max(...given) - first + 1 : blades.length, first, fit,
    of: fit ? given.map((n) => n - first) : given.map((_, i) => i),
    order: fit ? "by slot, front view" : blades.some((blade) => blade.slot) ? "by name: slots are not all numbers" : "by name: no slots are given",
  };
}

/** One stop of the Tab key for all blades; the arrow keys go round. */
function step(event, links) {
  const at = links.indexOf(document.activeElement);
  const to = { ArrowRight: at + 1, ArrowDown: at + 1, ArrowLeft: at - 1, ArrowUp: at - 1, Home: 0, End: -1 }[event.key];
  if (at < 0 || to === undefined || event.ctrlKey || event.altKey || event.metaKey) return;
  event.preventDefault();
  links.forEach((one) => one.setAttribute("tabindex", -1));
  const next = links.at(to % links.length);
  next.setAttribute("tabindex", 0);
  next.focus();
}

/**
 * The ring. `value(blade)` is a number or null, `span` its least and greatest, `tell(blade)` the
 * words for it, `sign(blade)` a sign where something is to be seen to.
 */
export function ring(rotor, blades, { value, span, what, unitName, tell, sign }) {
  const { count, first, of, fit, order } = slots(blades);
  const width = (2 * Math.PI) / Math.max(count, 1);
  const gap = Math.min(0.012, width / 8);
  const empty = [];
  for (let i = 0; i < count; i += 1) {
    if (!of.includes(i)) empty.push(s("path", { class: "none", d: sector(i * width + gap, (i + 1) * width - gap) }, s("title", {}, `slot ${i + first}: no blade`)));
  }
  const parts = blades.map((blade, k) => {
    const from = of[k] * width + gap;
    const number = value(blade);
    const at = number === null ? null : share(number, span);
    const middle = (of[k] + 0.5) * width;
    const mark = sign(blade);
    const seen = [s("path", {
      d: sector(from, (of[k] + 1) * width - gap),
      fill: at === null ? "none" : css(at),
      class: at === null ? "none" : null,
    }), s("title", {}, tell(blade))];
    if (mark) {
      seen.push(s("text", { class: "mark", x: ((R1 + 9) * Math.sin(middle)).toFixed(1), y: (4 - (R1 + 9) * Math.cos(middle)).toFixed(1) }, mark));
    }
    if (count <= 40) {
      const r = (R0 + R1) / 2;
      seen.push(s("text", {
        x: (r * Math.sin(middle)).toFixed(1), y: (4 - r * Math.cos(middle)).toFixed(1), "pointer-events": "none",
        class: at === null ? "soft" : dark(at) ? "on-light" : "on-dark",
      }, within(fit ? blade.slot : blade.id, room(count), 11)));
    }
    return s("a", { href: path`/rotors/${rotor}/blades/${blade.id}`, "aria-label": tell(blade), tabindex: k ? -1 : 0 }, seen);
  });
  const turns = count > 40
    ? [0, 0.25, 0.5, 0.75].map((part) => {
        const slot = Math.round(part * count);
        const a = (slot + 0.5) * width;
        return s("text", { class: "soft", x: ((R0 - 14) * Math.sin(a)).toFixed(1), y: (4 - (R0 - 14) * Math.cos(a)).toFixed(1) }, fit ? `${slot + first}` : within(blades[slot]?.id ?? "", 60, 11));
      })
    : [];
  const bar = [];
  for (let i = 0; i < 60; i += 1) bar.push(s("rect", { x: -90 + 3 * i, y: 14, width: 3.2, height: 10, "shape-rendering": "crispEdges", fill: css((i + 0.5) / 60) }));
  const at = ticks(span, 4);
  const marks = labels(at).map((text, i) =>
    s("text", { class: "soft", x: (-90 + 180 * share(at[i], span)).toFixed(1), y: 38 }, text));
  return s("svg", { class: "ring", viewBox: "-205 -205 410 410", role: "group", onkeydown: (event) => step(event, parts),
    "aria-label": `${blades.length} blades by ${fit ? "slot" : "name"}, coloured by ${what}; arrow keys go from blade to blade` },
    empty, parts, turns,
    s("text", { y: -30 }, order),
    s("text", { y: 0 }, `${what}${unit(unitName) ? ` [${unit(unitName)}]` : ""}`), bar, marks);
}
