// Verdicts and states of diagnoses in words.

import { fixed, number, words } from "./format.js";
import { badge } from "./states.js";

const VERDICTS = {
  adequate: ["ok", "adequate: the model lacks nothing that shows"],
  effect: ["warn", "an effect that the model lacks"],
  "not separable": ["warn", "a lack, by effects that cannot be told apart"],
  unattributed: ["bad", "a lack without a name"],
};
export const verdictOf = (word) => badge(...(VERDICTS[word] ?? ["warn", word]));

/** Who asked for a diagnosis: somebody, or the rotor itself, with what alarms in its residuals. */
export function askedBy(request) {
  const because = request.because;
  if (!because) return "somebody";
  if (!because.alarms) return `the rotor itself, for its readings: ${fixed(because.readings, 0)} count in version ${fixed(because.version, 0)}, a quarter more than when it asked last`;
  const told = because.tests.map((t) => `${words(t.grouping)}${t.value === null ? "" : ` ${t.value}`} (${t.statistic})`);
  const more = because.alarms > told.length ? " and more" : "";
  const count = because.alarms === 1 ? "one test alarms" : `${number(because.alarms, "test")} alarm`;
  return `the rotor’s residuals: ${count} in version ${fixed(because.version, 0)}, ${told.join(", ")}${more}`;
}

const STATES = { queued: "wait", running: "wait", done: "ok", failed: "bad", cancelled: "warn" };
export const stateOf = (diagnosis) => [STATES[diagnosis.status] ?? "warn", diagnosis.status];
