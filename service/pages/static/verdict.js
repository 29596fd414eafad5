// Verdicts and states of diagnoses in words.

import { badge } from "./states.js";

const VERDICTS = {
  adequate: ["ok", "adequate: the model lacks nothing that shows"],
  effect: ["warn", "an effect that the model lacks"],
  "not separable": ["warn", "a lack, by effects that cannot be told apart"],
  unattributed: ["bad", "a lack without a name"],
};
export const verdictOf = (word) => badge(...(VERDICTS[word] ?? ["warn", word]));

const STATES = { queued: "wait", running: "wait", done: "ok", failed: "bad", cancelled: "warn" };
export const stateOf = (diagnosis) => [STATES[diagnosis.status] ?? "warn", diagnosis.status];
