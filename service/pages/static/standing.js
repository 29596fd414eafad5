// What of a diagnosis is in its rotor's model, as the log says.

import { h, scroll, table } from "./dom.js";
import { fixed, inUnit, moment, withSd, words } from "./format.js";

/** The words for an entry that concerns a diagnosis. */
function happened(one) {
  if (one.what === "joining") return `blade ${one.blade} joined`;
  return one.what === "adoption" ? "adopted" : "backed out";
}

/** Whether what a diagnosis found is in the model: blades that joined since do not change that. */
export const isInForce = (history) => history.findLast((one) => one.what !== "joining")?.what === "adoption";

/** Whether a lack without a name widens the bands by a discrepancy, which can be adopted. */
export const isWider = (found) => found.verdict === "unattributed" && found.widened?.borne_out === true;

/** What of this diagnosis is in the rotor's model: when it was adopted, and since which version. */
export function standing(history, now, found) {
  const last = history.at(-1);
  if (!last) return [h("p", {}, "Not in the model."), found.not_adopted ? h("p", {}, `The rotor did not adopt it by itself: ${found.not_adopted}`) : null];
  const inForce = isInForce(history);
  const state = now.posterior;
  const computed = state !== null && state.through_seq >= last.seq;
  const what = !inForce ? "the network before it" : isWider(found) ? "the discrepancy" : "the effect";
  return [
    h("p", {}, h("strong", {}, inForce ? "Adopted." : "Backed out."), " ",
      computed ? `Version ${fixed(state.version, 0)} of the posterior has ${what}${state.sealed ? "" : "; it is provisional, the sealed one follows"}.`
        : `The next version will have ${what}; a worker has yet to compute it.`),
    scroll("Adoptions", table([
      { name: "What happened", value: happened },
      { name: "Entry", value: (one) => fixed(one.seq, 0), number: true },
      { name: "When", value: (one) => moment(one.at) },
      { name: "By key", value: (one) => (one.unasked ? "the rotor itself" : one.posted_by ?? "–") },
      { name: "Chosen", value: (one) => (one.chosen ? `alternative ${one.chosen.alternative}: ${one.chosen.because}` : "–") },
      { name: "Readings since the diagnosis", value: (one) => (one.readings_since === null ? "–" : fixed(one.readings_since, 0)), number: true },
    ], history)),
  ];
}

/** The effects that were put into the model with it, as its adoption has them. */
export function effectsOf(history) {
  const { effects } = history.findLast((one) => one.what === "adoption");
  return scroll("Effects", table([
    { name: "Effect", value: (e) => e.name },
    { name: "What happens", value: (e) => e.words ?? "–" },
    { name: "Amplitude", value: ({ amplitude: a }) => (a ? inUnit(withSd(a.mean, a.sd), a.unit) : "–"), number: true },
    { name: "Of", value: ({ amplitude: a }) => words(a?.of ?? "–") },
  ], effects));
}
